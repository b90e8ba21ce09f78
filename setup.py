"""The compiled modules of the package, and how they are compiled; all else about the package is in `pyproject.toml`.

After an edit of a ``.pyx`` or ``.pxd`` file, ``python setup.py build_ext --inplace`` compiles what changed.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import sysconfig
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py

sys.path.insert(0, str(Path(__file__).parent))
from build_backend import ZIG, compiler

# Modules that compute one number after the other. Vector instructions make them slower.
SCALAR = [
    "safe_ompl.robot.kinematics",
    "safe_ompl.geometry.convex",
    "safe_ompl.collision.proofs",
    "safe_ompl.danger.static",
    "safe_ompl.danger.moving",
    "safe_ompl.planning.planners.growth",
    "safe_ompl.planning.simplification.costs",
    "safe_ompl.planning.simplification.descent",
    "safe_ompl.planning.simplification.edges",
    "safe_ompl.geometry.surface_points",
    "safe_ompl.live.replanning.hull_gaps",
    "safe_ompl.motions.bodies",
    "safe_ompl.motions.laws",
    "safe_ompl.drawing.rendering",
]
# Modules that compute several numbers side by side, by SIMD instructions. NAME.pyx is compiled for all processors, and
# NAME_v3.pyx, which includes NAME.pyx, for those with AVX2; the package chooses when it is imported.
LANES = ["safe_ompl.danger.lanes"]

# Cython's code for memory views is compiled once, into this module, instead of into every module.
SHARED = "safe_ompl.common.memoryviews"
# Cython 3.2 names the module after the file, so the version stands in the name of the folder.
SHARED_SOURCE = f"build/cython_{version('Cython')}/memoryviews.c"

# Results must not depend on the compiler, so fused multiply-add (-ffp-contract) is off, and -ffast-math is never used.
# The two -fno-… flags change no result; without them loops that take square roots are not vectorised.
FLAGS = ["-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-g0"]
# A loop over ten arrays is vectorised only if GCC may check at run time that none of them overlap. By default it makes
# fewer checks, and gradients of soft maxima take 1.25 times as long. Clang has no such limit and ignores the flag.
MANY_ARRAYS = "--param=vect-max-version-for-alias-checks=100"
DIRECTIVES: dict[str, object] = {
    "language_level": 3,
    "infer_types": True,
    "boundscheck": False,
    "wraparound": False,
    "initializedcheck": False,
    "cdivision": True,
}


def level(name: str, with_zig: bool) -> list[str]:
    """Return the flag for a level of x86-64's instructions; none on other processors, whose baseline has vectors."""
    if platform.machine() not in ("x86_64", "AMD64"):
        return []
    return [f"-march={name.replace('-', '_') if with_zig else name}"]


def extensions(with_zig: bool) -> list[Extension]:
    """Return all compiled modules."""

    def extension(module: str, *flags: str) -> Extension:
        source = module.replace(".", "/") + ".pyx"
        return Extension(module, [source], extra_compile_args=[*FLAGS, *flags])

    baseline = level("x86-64", with_zig)
    scalar = [extension(module, *baseline, "-fno-tree-slp-vectorize") for module in SCALAR]
    more = [] if with_zig else [MANY_ARRAYS]
    lanes = [extension(module, *level("x86-64-v2", with_zig), *more) for module in LANES]
    lanes += [extension(f"{module}_v3", *level("x86-64-v3", with_zig), *more) for module in LANES]
    shared = Extension(SHARED, [SHARED_SOURCE], extra_compile_args=["-O2", "-g0"])
    return [*scalar, *lanes, shared]


class BuildModules(build_ext):
    """Translates modules to C and compiles them, on all processors."""

    def finalize_options(self) -> None:
        super().finalize_options()
        self.parallel = self.parallel or os.cpu_count() or 1

    def run(self) -> None:
        # Only here, as pip runs this file several times before it builds.
        from Cython.Build import cythonize
        from Cython.Build.SharedModule import generate_shared_module
        from Cython.Compiler.Options import CompilationOptions

        header, python = Path(sysconfig.get_path("include"), "Python.h"), f"python{sysconfig.get_python_version()}"
        if not header.exists():
            sys.exit(f"{header} is missing: install {python}-dev (Debian, Ubuntu) or python3-devel (Fedora)")
        own = compiler()
        if own is None and find_spec("ziglang") is None:
            sys.exit("there is no C compiler: install one (gcc or clang), or one from PyPI: pip install ziglang")
        os.environ["CC"] = own or ZIG
        if not Path(SHARED_SOURCE).exists():
            unfinished = Path("build/unfinished")
            unfinished.mkdir(parents=True, exist_ok=True)
            source = str(unfinished / "memoryviews.c")
            generate_shared_module(CompilationOptions(shared_c_file_path=source, module_name=SHARED))
            Path(SHARED_SOURCE).parent.mkdir(exist_ok=True)
            os.replace(source, SHARED_SOURCE)
        ours = [module for module in self.extensions if module.name != SHARED]
        translated = cythonize(
            ours,
            compiler_directives=DIRECTIVES,
            shared_utility_qualified_name=SHARED,
            build_dir="build",
            nthreads=self.parallel,
        )
        for module, of_c in zip(ours, translated, strict=True):
            module.sources = of_c.sources
        super().run()


class CopyModules(build_py):
    """Copies the package and, into it, the scenarios; an editable install finds both where they are."""

    def run(self) -> None:
        if not self.editable_mode:
            # What an earlier build copied may have been removed or renamed since.
            compiled = self.get_finalized_command("build_ext").get_outputs()
            for path in Path(self.build_lib).rglob("*"):
                if path.is_file() and str(path) not in compiled:
                    path.unlink()
            package = Path(self.build_lib, "safe_ompl")
            shutil.copytree("scenarios", package / "scenarios", dirs_exist_ok=True)
        super().run()


if __name__ == "__main__":
    setup(
        ext_modules=extensions(with_zig=compiler() is None),
        cmdclass={"build_ext": BuildModules, "build_py": CopyModules},
    )
