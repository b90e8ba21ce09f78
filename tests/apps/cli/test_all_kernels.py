"""`doctor` compiles all kernels that there are, none of them needs SciPy, and a wheel with their machine code none."""

import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from pkgutil import resolve_name

import pytest

import safe_ompl
from safe_ompl.apps.cli.doctor import ALL_JOBS

ROOT = Path(__file__).parents[3]
HOOK = runpy.run_path(str(ROOT / ".ci" / "machine_code.py"))


@pytest.fixture(scope="module")
def kernels():
    for job in ALL_JOBS:
        resolve_name(job)()
    return list(HOOK["all_kernels"]())


def test_jobs_ask_for_all_kernels(kernels):
    """What only other kernels call is asked for when these are compiled: later it is kept, and nobody asks."""
    assert len(kernels) > len(ALL_JOBS)
    for kernel in kernels:
        asked = kernel.signatures or sum(kernel.stats.cache_hits.values())
        assert asked or kernel._cache._cache_file._load_index(), kernel


@pytest.mark.end_to_end
def test_a_package_with_machine_code_compiles_nothing_and_finds_the_same_paths_bit_for_bit(kernels, tmp_path):
    """The machine code is that of this machine; `.ci/environments` tries the wheel, which is for others, too."""
    package = tmp_path / "safe_ompl"
    shutil.copytree(Path(safe_ompl.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    HOOK["copy_kept"](kernels, package)

    def paths(root, **variables):
        program = "from bench.same import runs; print(dict(runs(['planar3'])))"
        variables = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), str(ROOT), *sys.path])} | variables
        words = [sys.executable, "-c", program]
        done = subprocess.run(words, cwd=root, env=variables, capture_output=True, text=True)
        assert not done.returncode, done.stderr[-2000:]
        return done.stdout, done.stderr

    shutil.copytree(ROOT / "scenarios", package / "scenarios")
    found, said = paths(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    assert found.count("simplified") > 5
    assert found == paths(Path(safe_ompl.__file__).parents[1])[0]
    assert "compiling" not in said
    assert not list((tmp_path / "cache").rglob("*.nb?"))
