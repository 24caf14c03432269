"""The process that a daemon with [ros] keeps running."""

import sys

from skygcs.cli.process import EXIT_FAILED, configure_logging, run_loop
from skygcs.errors import SkygcsError
from skygcs.ext.ros.process import options_of, serve_ros


def main() -> int:
    """Run it; the exit code."""
    configure_logging(verbose=False, quiet=True)
    try:
        options = options_of(sys.argv[1:])

        async def serve() -> int:
            await serve_ros(options)
            return 0

        return run_loop(serve())
    except SkygcsError as error:
        print(f"skygcs ros: {error}", file=sys.stderr)
        return EXIT_FAILED


if __name__ == "__main__":
    sys.exit(main())
