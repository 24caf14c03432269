"""Build hook: compile the express lane where a compiler is there. Without one skygcs is pure Python and just slower.

No setuptools: one C file and the interpreter's own compiler flags are all there is to it.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCE = Path("src/skygcs/links/_express.c")
COMPILE_TIMEOUT_S = 120


class ExpressLaneHook(BuildHookInterface):
    """Adds the extension to wheels and editable installations; never fails a build."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        if self.target_name != "wheel" or os.environ.get("SKYGCS_PURE"):
            return
        built = self._compile()
        if built is not None:
            build_data["artifacts"].append(str(built))
            build_data["pure_python"] = False
            build_data["infer_tag"] = True

    def _compile(self) -> Path | None:
        """The extension beside its source, relative to the project; None (and why, in the log) if it cannot be."""
        built = SOURCE.with_name("_express" + (sysconfig.get_config_var("EXT_SUFFIX") or ".so"))
        compiler = os.environ.get("CC") or sysconfig.get_config_var("CC")
        if sys.platform != "linux" or not compiler:
            return None
        command = [*shlex.split(compiler), "-O2", "-shared", "-fPIC", "-I", sysconfig.get_path("include")]
        try:
            subprocess.run(
                [*command, "-o", str(built), str(SOURCE)],
                cwd=self.root,
                check=True,
                capture_output=True,
                text=True,
                timeout=COMPILE_TIMEOUT_S,
            )
        except (OSError, subprocess.SubprocessError) as error:
            why = getattr(error, "stderr", None) or str(error)
            self.app.display_warning(f"the express lane was not built, skygcs will be pure Python: {why}")
            return None
        return built
