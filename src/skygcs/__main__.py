"""`python -m skygcs`, and `skygcs` itself."""

import sys


def main() -> None:
    """Entry point of `skygcs`: the daemon's libraries are imported lean, before anything imports them whole."""
    if sys.argv[1:2] == ["run"]:
        from skygcs.cli.lean_imports import needs_tls, prepare_daemon

        prepare_daemon(tls=needs_tls(sys.argv[2:]))
    from skygcs.cli.serve import main as serve

    serve()


if __name__ == "__main__":
    main()
