"""Build hook: compile the fast path where a compiler is there. Without one skygcs is pure Python and just slower.

No setuptools: one C file, the interpreter's own compiler and a few flags are all there is to it. Environment variables:
CC, CFLAGS and LDFLAGS as usual; SKYGCS_PURE leaves the fast path out; SKYGCS_REQUIRE_FASTPATH makes an installation
without it fail, and warnings of the compiler errors.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

SOURCE = Path("src/skygcs/links/_fast_path.c")
COMPILE_TIMEOUT_S = 120

BASIC = ["-O2", "-shared", "-fPIC"]

WARNINGS = ["-Wall", "-Wextra"]

HARDENING = [
    "-fstack-protector-strong",
    "-fstack-clash-protection",
    "-U_FORTIFY_SOURCE",  # which distributions set, with another value
    "-D_FORTIFY_SOURCE=3",  # a C library that knows only 2 takes it for 2
    "-fvisibility=hidden",
    "-Wl,-z,relro,-z,now,-z,noexecstack",
]
"""Costs nothing that a benchmark shows. What is not known to a stranger's compiler is left out, all of it."""


LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s]+)(?=\))")
"""The destination of a link or picture within the repository."""


class ReadmeHook(MetadataHookInterface):
    """README.md with links that lead to the repository, and the project's URLs."""

    def update(self, metadata: dict[str, Any]) -> None:
        repository = self.config["repository"]
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        text = LINK.sub(lambda link: f"{repository}/{_view(link[1])}/main/{link[1]}", text)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        metadata["urls"] = {
            "Source": repository,
            "Documentation": f"{repository}/tree/main/docs",
            "Issues": f"{repository}/issues",
            "Changelog": f"{repository}/blob/main/CHANGELOG.md",
        }


def _view(path: str) -> str:
    """A picture is shown as it is, a page as a page."""
    return "raw" if path.endswith((".svg", ".png", ".gif", ".jpg")) else "blob"


class FastPathHook(BuildHookInterface):
    """Adds the extension to wheels and editable installations; fails a build only if it is required."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        required = bool(os.environ.get("SKYGCS_REQUIRE_FASTPATH"))
        if self.target_name != "wheel":
            return
        if os.environ.get("SKYGCS_PURE"):
            if required:
                raise RuntimeError("SKYGCS_PURE and SKYGCS_REQUIRE_FASTPATH contradict each other: set one of them")
            return
        try:
            built = self._compile(required)
        except (OSError, subprocess.SubprocessError) as error:
            why = getattr(error, "stderr", None) or str(error)
            if required:
                raise RuntimeError(
                    f"the fast path cannot be compiled, and SKYGCS_REQUIRE_FASTPATH is set: {why}"
                ) from None
            self.app.display_warning(f"the fast path was not compiled, skygcs will be pure Python: {why}")
            return
        build_data["artifacts"].append(str(built))
        build_data["pure_python"] = False
        build_data["infer_tag"] = True

    def _compile(self, required: bool) -> Path:
        """The extension beside its source, relative to the project. Raises OSError or SubprocessError."""
        built = SOURCE.with_name("_fast_path" + (sysconfig.get_config_var("EXT_SUFFIX") or ".so"))
        compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "")
        if sys.platform != "linux" or not compiler:
            raise OSError(
                f"it needs Linux and a C compiler; here: {sys.platform}, CC = {' '.join(compiler) or 'unset'}"
            )
        before, after = (shlex.split(os.environ.get(name, "")) for name in ("CFLAGS", "LDFLAGS"))
        common = [*before, "-I", sysconfig.get_path("include"), "-o", str(built), str(SOURCE), *after]
        if required:
            self._run([*compiler, *BASIC, *WARNINGS, "-Werror", *HARDENING, *common])
            return built
        try:
            self._run([*compiler, *BASIC, *WARNINGS, *HARDENING, *common])
        except subprocess.CalledProcessError:
            self._run([*compiler, *BASIC, *common])
        return built

    def _run(self, command: list[str]) -> None:
        subprocess.run(command, cwd=self.root, check=True, capture_output=True, text=True, timeout=COMPILE_TIMEOUT_S)
