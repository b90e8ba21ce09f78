"""The compiled modules of the package, and how they are compiled; all else about the package is in `pyproject.toml`.

After an edit of a ``.pyx`` or ``.pxd`` file, ``python setup.py build_ext --inplace`` compiles what changed.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import sysconfig
from pathlib import Path

from Cython.Build import cythonize
from Cython.Build.SharedModule import generate_shared_module
from Cython.Compiler.Options import CompilationOptions
from setuptools import Extension, find_packages, setup
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
    "safe_ompl.planning.simplification.costs",
    "safe_ompl.geometry.surface_points",
    "safe_ompl.motions.bodies",
    "safe_ompl.motions.laws",
    "safe_ompl.drawing.rendering",
]
# Modules that compute several numbers side by side, by SIMD instructions. NAME.pyx is compiled for all processors, and
# NAME_v3.pyx, which includes NAME.pyx, for those with AVX2; the package chooses when it is imported.
LANES = ["safe_ompl.danger.lanes"]

# Cython's code for memory views is compiled once, into this module, instead of into every module.
SHARED = "safe_ompl.common.memoryviews"

# Results must not depend on the compiler, so fused multiply-add (-ffp-contract) is off, and -ffast-math is never used.
# The two -fno-… flags change no result; without them loops that take square roots are not vectorised.
FLAGS = ["-O3", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-g0"]
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
        return Extension(module, [module.replace(".", "/") + ".pyx"], extra_compile_args=[*FLAGS, *flags])

    baseline = level("x86-64", with_zig)
    scalar = [extension(module, *baseline, "-fno-tree-slp-vectorize") for module in SCALAR]
    lanes = [extension(module, *level("x86-64-v2", with_zig)) for module in LANES]
    lanes += [extension(f"{module}_v3", *level("x86-64-v3", with_zig)) for module in LANES]
    return scalar + lanes


def shared_module() -> Extension:
    """Return the module with Cython's code for memory views, and write its source."""
    source = Path("build", SHARED.rpartition(".")[2] + ".c")
    source.parent.mkdir(exist_ok=True)
    generate_shared_module(CompilationOptions(shared_c_file_path=str(source), module_name=SHARED))
    return Extension(SHARED, [str(source)], extra_compile_args=["-O2"])


class BuildModules(build_ext):
    """Compiles modules on all processors."""

    def finalize_options(self) -> None:
        super().finalize_options()
        self.parallel = self.parallel or os.cpu_count()


class CopyScenarios(build_py):
    """Copies the scenarios of the checkout into the package; an editable install finds them where they are."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            shutil.copytree("scenarios", Path(self.build_lib, "safe_ompl", "scenarios"), dirs_exist_ok=True)


def build() -> None:
    """Build the package."""
    header = Path(sysconfig.get_path("include"), "Python.h")
    if not header.exists():
        version = f"{sys.version_info[0]}.{sys.version_info[1]}"
        sys.exit(f"{header} is missing: install python{version}-dev (Debian, Ubuntu) or python3-devel (Fedora)")
    own = compiler()
    os.environ["CC"] = own or ZIG
    modules = cythonize(
        extensions(with_zig=own is None),
        compiler_directives=DIRECTIVES,
        shared_utility_qualified_name=SHARED,
        build_dir="build",
        nthreads=os.cpu_count() or 1,
    )
    setup(
        packages=find_packages(include=["safe_ompl*"]),
        ext_modules=[*modules, shared_module()],
        cmdclass={"build_ext": BuildModules, "build_py": CopyScenarios},
    )


if __name__ == "__main__":
    build()
