"""`doctor` compiles all kernels that there are, and none of them needs SciPy."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest

import safe_ompl
from safe_ompl.apps.cli.doctor import ALL_JOBS
from safe_ompl.common.compilation import sources


def test_jobs_ask_for_all_kernels():
    for job in ALL_JOBS:
        resolve_name(job)()
    package = Path(safe_ompl.__file__).parent
    for path in sources(package):
        parts = path.relative_to(package).with_suffix("").parts
        module = import_module(".".join(("safe_ompl", *(part for part in parts if part != "__init__"))))
        for name, kernel in vars(module).items():
            if hasattr(kernel, "py_func") and kernel.__module__ == module.__name__:
                loaded = kernel.signatures or sum(kernel.stats.cache_hits.values())
                assert loaded or not hasattr(kernel._cache, "_cache_file"), f"{module.__name__}.{name}"


@pytest.mark.end_to_end
def test_no_kernel_needs_scipy_to_be_compiled(tmp_path):
    """Numba asks for SciPy when it compiles `@` or np.linalg, and not when it loads them from its cache."""
    (tmp_path / "scipy.py").write_text("raise ImportError('scipy is missing')\n")
    paths = os.pathsep.join([str(tmp_path), str(Path(safe_ompl.__file__).parents[1])])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": paths}
    program = f"import runpy; runpy.run_path({__file__!r})['test_jobs_ask_for_all_kernels']()"
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert not done.returncode, done.stderr[-2000:]
