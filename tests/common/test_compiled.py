"""Kernels are compiled once, for one kind of arguments each, kept on disk, and said so once."""

import ast
import ctypes
import gc
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from time import perf_counter, sleep
from types import SimpleNamespace

import pytest
from numba.core import event

import safe_ompl
from safe_ompl.common import compilation as compiled, machine_code, stack
from safe_ompl.drawing import rasteriser

PROGRAM = """
import logging, sys
logging.basicConfig(format="%(name)s %(message)s", stream=sys.stdout)
import numpy as np
from safe_ompl.drawing.rasteriser import interpolated
interpolated(np.eye(3), np.array([[0, 1, 2]]), np.ones((3, 1)), np.zeros(3), np.ones((1, 3)))
print(interpolated.stats.cache_hits)
"""


def run(cache, **options):
    folder = str(Path(safe_ompl.__file__).parents[0])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": folder} | options
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True)
    assert not done.stderr
    return done.stdout.splitlines()


def test_says_once_that_it_compiles_and_keeps_what_it_compiled(tmp_path):
    first, second = run(tmp_path), run(tmp_path)
    assert first[0].startswith("safe_ompl.common.compilation compiling kernels")
    assert [first[1:], second] == [["Counter()"], [second[0]]]
    assert second[0].startswith("Counter({")


def test_says_what_to_do_where_nothing_can_be_kept(tmp_path):
    no_folder = {"NUMBA_CACHE_LOCATOR_CLASSES": "IPythonCacheLocator"}  # as where none can be written to
    lines = run(tmp_path, **no_folder)
    assert lines[0].endswith("name one with NUMBA_CACHE_DIR")
    assert lines[1:] == ["Counter()"]


@pytest.mark.parametrize("ask", [lambda kernel: kernel(3), lambda kernel: kernel.doubled])
def test_a_kernel_is_made_when_it_is_first_asked_for_and_then_kept(ask):
    def twice(x):
        return 2 * x

    def make(function, options):
        made.append(options)
        function.doubled = function(3)
        return function

    made = []
    kernel = compiled._lazily(make, twice, {"fastmath": False})
    assert not made
    assert kernel.__name__ == "twice"
    assert [ask(kernel), ask(kernel)] == [6, 6]
    assert made == [{"fastmath": False}]


def test_no_part_calls_one_that_returns_new_arrays():
    """They would never be freed: a part does not count who holds which array."""
    functions = {"maker": [], "expanded": [], "part": []}
    for file in machine_code.sources(Path(compiled.__file__).parents[1]):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            for decorator in getattr(node, "decorator_list", ()):
                functions.setdefault(ast.unparse(decorator), []).append(node)
    numbers = ("None", "float", "int", "tuple[float, int]")
    makers = functions["maker"] + functions["expanded"]
    returning = {node.name for node in makers if ast.unparse(node.returns) not in numbers}
    for node in functions["part"]:
        called = {call.func.id for call in ast.walk(node) if hasattr(getattr(call, "func", None), "id")}
        assert not called & returning, node.name


def test_no_kernel_multiplies_matrices_by_blas():
    """For that Numba wants SciPy, which is no requirement; loops of three are faster, too."""
    wanting = re.compile(r" @ |\bnp\.(dot|vdot|linalg|inner|cov|corrcoef|convolve|correlate)\b|\.dot\(")
    for file in machine_code.sources(Path(compiled.__file__).parents[1]):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            decorators = {ast.unparse(decorator) for decorator in getattr(node, "decorator_list", ())}
            if decorators & {"caller", "compiled", "expanded", "inlined", "maker", "part"}:
                found = [line for line in ast.unparse(node.body).splitlines() if wanting.search(line)]
                assert not found, f"{file}: {node.name}: {found}"


@pytest.fixture
def made():
    """Return the event that a kernel of the package, wherever it is, is compiled."""

    class Dispatcher:
        __module__ = "safe_ompl.anywhere.somewhere"

    return event.Event("numba:compile", event.EventStatus.START, {"dispatcher": Dispatcher()})


def test_the_clock_of_time_limits_stands_while_kernels_are_compiled(made):
    """A first plan after an installation would be over before it began."""
    compilation = compiled._Compilation()
    compilation.on_start(made)
    compilation.on_start(made)  # one that it calls
    compilation.on_end(made)
    assert compilation.seconds == 0.0
    compilation.on_end(made)
    once = compilation.seconds
    assert once > 0.0
    stood, went = compiled.clock(), perf_counter()
    for status in (event.EventStatus.START, event.EventStatus.END):
        event.broadcast(event.Event("numba:compile", status, made.data))
        sleep(0.02)
    assert compiled.clock() - stood <= perf_counter() - went - 0.02


@pytest.mark.parametrize("heard", ["as the kernel ends", "as the next one begins"])
def test_ctrl_c_is_not_lost_where_the_compiler_calls_python_from_c(made, heard, monkeypatch):
    """A command that was interrupted while machine code was written went on, and ended well 88 s later."""
    ignored = []
    monkeypatch.setattr(sys, "unraisablehook", lambda unraisable: ignored.append(unraisable.exc_type))

    @ctypes.CFUNCTYPE(None)
    def called_from_c():
        os.kill(os.getpid(), signal.SIGINT)

    before, compilation = signal.getsignal(signal.SIGINT), compiled._Compilation()
    compilation.on_start(made)
    called_from_c()
    assert ignored == [KeyboardInterrupt], "it was lost"
    if heard == "as the kernel ends":
        with pytest.raises(KeyboardInterrupt):
            compilation.on_end(made)
    else:
        with pytest.raises(KeyboardInterrupt):
            compilation.on_start(made)
        compilation.on_end(made)
        compilation.on_end(made)
    assert signal.getsignal(signal.SIGINT) is before
    compilation.on_start(made)
    compilation.on_end(made)


CALLER = """
from safe_ompl.common.compilation import {0}
from safe_ompl.third.callee import one


@{0}
def two(x):
    return one(x) + one(x)
"""
CALLEE = """
from safe_ompl.common.compilation import (
    {0},
)


@{0}
def one(x):
    return {1} * x
"""


def _package(folder, outer, inner):
    """Write a copy of the package into a folder, with a kernel `two` of one kind that calls `one` of another."""
    package = folder / "safe_ompl"
    shutil.copytree(Path(safe_ompl.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    for name, text in (("other/caller", CALLER.format(outer)), ("third/callee", CALLEE.format(inner, 1.0))):
        file = package / f"{name}.py"
        file.parent.mkdir()
        (file.parent / "__init__.py").touch()
        file.write_text(text)
    return package


def _answer(folder, program, **variables):
    variables = {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(folder)} | variables
    words = [sys.executable, "-c", *program]
    done = subprocess.run(words, cwd=folder, env=os.environ | variables, capture_output=True, text=True)
    assert not done.returncode, done.stderr
    return done.stdout.split(), done.stderr


@pytest.mark.parametrize(("outer", "inner"), [("compiled", "part"), ("caller", "compiled")])
def test_a_kernel_is_compiled_anew_when_what_it_calls_in_another_folder_changes(tmp_path, outer, inner):
    """What it calls is compiled into it: else a stale proof would run."""
    package = _package(tmp_path, outer, inner)
    program = "from safe_ompl.other.caller import two; print(two(1.0), sum(two.stats.cache_hits.values()))"

    def answer():
        return _answer(tmp_path, [program])[0]

    assert [answer(), answer()] == [["2.0", "0"], ["2.0", "1"]]
    (package / "third" / "callee.py").write_text(CALLEE.format(inner, 10.0))
    assert answer() == ["20.0", "0"]
    (package / "third" / "__init__.py").write_text("# no kernel\n")
    assert answer() == ["20.0", "1"], "a file without kernels leaves them as they are"


def test_a_kernel_from_the_disk_is_compiled_into_one_that_calls_it(tmp_path):
    """Its bitcode is read only then: to load kernels took ten times as long when it was always read."""
    _package(tmp_path, "caller", "compiled")
    first = "from safe_ompl.third.callee import one; print(one(1.0), sum(one.stats.cache_hits.values()))"
    second = "; from safe_ompl.other.caller import two; print(two(1.0), sum(two.stats.cache_hits.values()))"
    assert _answer(tmp_path, [first])[0] == ["1.0", "0"]
    assert _answer(tmp_path, [first + second])[0] == ["1.0", "1", "2.0", "0"]


SHIP = """
import runpy, sys
from pathlib import Path
from safe_ompl.other.caller import two
two(1.0)
runpy.run_path(sys.argv[1])["copy_kept"]([two], Path("safe_ompl"))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return a folder with a package that holds the machine code of a kernel for a processor with AVX."""
    folder = tmp_path_factory.mktemp("wheel")
    _package(folder, "compiled", "part")
    hook = Path(__file__).parents[2] / ".ci" / "machine_code.py"
    _answer(folder, [SHIP, str(hook)], NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES=_HAS)
    shutil.rmtree(folder / "cache")
    return folder


_HAS = "" if platform.machine() != "x86_64" else "+avx"


def _damage(folder):
    (file,) = folder.rglob("machine_code/*/*.nbc")
    file.write_bytes(file.read_bytes()[:40])


@pytest.mark.parametrize(
    ("change", "variables", "answer", "said"),
    [
        (None, {}, "2.0 1 0", ""),
        (None, {"NUMBA_CACHE_LOCATOR_CLASSES": "IPythonCacheLocator"}, "2.0 1 0", ""),  # no folder to write to
        (lambda folder: [os.utime(file, (0, 0)) for file in folder.rglob("*.py")], {}, "2.0 1 0", ""),
        (None, {"NUMBA_CPU_FEATURES": "+sse2"}, "2.0 0 1", "compiling"),  # it may be asked for what it may use
        (
            lambda folder: (folder / "safe_ompl/third/callee.py").write_text(CALLEE.format("part", 10.0)),
            {},
            "20.0 0 1",
            "compiling",
        ),
        (
            lambda folder: [file.rename(f"{file}0") for file in folder.glob("safe_ompl/machine_code/*")],
            {},
            "2.0 0 1",
            "compiling",
        ),
        (_damage, {}, "2.0 0 1", "damaged"),
    ],
    ids=[
        "as it is",
        "nothing can be kept",
        "other times",
        "a lesser processor",
        "other sources",
        "other versions",
        "damaged",
    ],
)
def test_machine_code_of_the_wheel_is_loaded_where_it_fits(wheel, tmp_path, change, variables, answer, said):
    """What runs is of these sources, versions and instructions, and never of others."""
    shutil.copytree(wheel, tmp_path, dirs_exist_ok=True)
    if change:
        change(tmp_path)
    program = """if True:
        import logging; logging.basicConfig()
        from pathlib import Path
        from safe_ompl.other.caller import two
        print(two(1.0), sum(two.stats.cache_hits.values()), len(list(Path("cache").rglob("*.nbc"))))
    """
    found, heard = _answer(tmp_path, [program], **variables)
    assert found == answer.split()
    assert (said in heard) if said else not heard


def test_kernels_call_and_use_nothing_of_files_that_are_not_watched():
    """Constants of other modules are compiled into kernels, too."""
    package = Path(safe_ompl.__file__).parent
    files = machine_code.sources(package)
    assert Path(rasteriser.__file__) in files
    names = [".".join(("safe_ompl", *file.relative_to(package).with_suffix("").parts)) for file in files]
    watched = {name.removesuffix(".__init__") for name in names} | {compiled.__name__, stack.__name__}
    for module in watched & set(sys.modules):
        names = vars(sys.modules[module])
        kernels = [value.py_func for value in names.values() if hasattr(value, "py_func")]
        used = {name for kernel in kernels for name in kernel.__code__.co_names if name in names}
        for name in used:
            home = getattr(names[name], "__module__", None) or getattr(names[name], "__name__", "")
            if home.startswith("safe_ompl"):
                assert home in watched, f"{module} uses {name} of {home}"


ARRAYS = """
import signal, sys
import numpy as np
from safe_ompl.common.compilation import compiled

@compiled
def arrays(n):
    return np.zeros(n), np.zeros(n)

def ctrl_c(frame, event, argument):
    if event == "call" and frame.f_code.co_name == function:
        sys.setprofile(None)
        signal.raise_signal(signal.SIGINT)

early, function = sys.argv[1:]
signal.signal(signal.SIGINT, signal.default_int_handler)
if early == "False":
    arrays(3)
sys.setprofile(ctrl_c)
try:
    arrays(3)
except KeyboardInterrupt:
    print("interrupted")
sys.setprofile(None)
print(len(arrays(3)), sum(arrays.stats.cache_hits.values()))
"""


@pytest.fixture(scope="module")
def arrays(tmp_path_factory):
    """Return a function that runs a program with a kernel that is kept in a folder, and that folder."""
    folder = tmp_path_factory.mktemp("arrays")
    (folder / "arrays.py").write_text(ARRAYS)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder)}

    def answer(early=True, function="none"):
        words = [sys.executable, str(folder / "arrays.py"), str(early), function]
        done = subprocess.run(words, env=environment, capture_output=True, text=True)
        return done.returncode, done.stdout, done.stderr

    assert answer() == (0, "2 0\n", "")
    return answer, folder


@pytest.mark.parametrize(
    ("early", "function", "said"),
    [
        (True, "_object_getbuffer_hook", "interrupted\n2 1\n"),  # it waits until the kernel is loaded: else it crashed
        (False, "_numba_unpickle", "2 1\n"),  # where the class of arrays is looked up it was a SystemError
    ],
)
def test_ctrl_c_does_no_harm_while_numba_calls_python(arrays, early, function, said):
    assert arrays[0](early, function) == (0, said, "")


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
def test_a_kernel_whose_file_is_damaged_is_compiled_anew(arrays, ending):
    answer, folder = arrays
    (file,) = folder.rglob(f"*.{ending}")
    file.write_bytes(file.read_bytes()[:40])
    code, out, err = answer()
    assert (code, out) == (0, "2 0\n")
    assert err.startswith(f"{file.parent}: a kernel that was kept is damaged")
    assert err.count("\n") == 1
    assert answer() == (0, "2 1\n", "")


# ------------------------------------------------------------------------------ two processes compile together

JOBS = """
import os, signal, time
from pathlib import Path
FOLDER = Path({folder!r})
HERE = os.environ["PARENT"] == str(os.getpid())

def write_and_await(name, other):
    (FOLDER / name).write_text(str(os.getpid()))
    while not (FOLDER / other).exists() or not (FOLDER / other).read_text():
        time.sleep(0.001)

def first(): write_and_await("first", "second")
def second(): write_and_await("second", "first")
def third(): (FOLDER / f"third{{os.getpid()}}").touch()

def both(then):
    write_and_await("here" if HERE else "there", "there")
    if not HERE:
        exec(then)

def killed(): both("os.kill(os.getpid(), 9)")
def fails(): both("raise ValueError")
def leaves(): both("os._exit(1)")

def interrupted():
    both("time.sleep(600)")
    raise KeyboardInterrupt

def dies():
    both("time.sleep(600)")
    os.kill(os.getpid(), signal.SIGKILL)

"""


@pytest.fixture
def jobs(tmp_path, monkeypatch):
    """Return a function that names functions of a module, which both processes can import."""
    (tmp_path / "jobs.py").write_text(JOBS.format(folder=str(tmp_path)))
    monkeypatch.setenv("PARENT", str(os.getpid()))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "jobs", raising=False)
    yield lambda *names: [f"jobs:{name}" for name in names]
    sys.modules.pop("jobs", None)


@pytest.fixture
def cold(monkeypatch):
    """Return a kernel that is not kept yet, and a list of the processes that are started for it."""
    started = []

    class Popen(subprocess.Popen):
        def __init__(self, *arguments, **options):
            started.append(self)
            super().__init__(*arguments, **options)

    monkeypatch.setattr(compiled, "Popen", Popen)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    files, real = SimpleNamespace(_load_index=dict), rasteriser.interpolated
    cache = SimpleNamespace(_cache_file=files)
    return SimpleNamespace(_cache=cache, py_func=real.py_func, targetctx=real.targetctx), started


def test_either_process_takes_the_next_job_and_each_job_is_done_once(cold, jobs, tmp_path):
    kernel, started = cold
    compiled.compile_together([kernel], jobs("first", "second", "third"))
    pids = {(tmp_path / name).read_text() for name in ("first", "second")}
    assert pids == {str(os.getpid()), str(started[0].pid)}
    assert len(list(tmp_path.glob("third*"))) == 1
    assert started[0].returncode == 0


@pytest.mark.parametrize("job", ["killed", "fails", "leaves"])
def test_a_process_that_ends_early_does_no_harm(cold, jobs, tmp_path, job):
    kernel, started = cold
    compiled.compile_together([kernel], [*jobs(job, job), *jobs("third")])
    assert started[0].returncode
    assert (tmp_path / f"third{os.getpid()}").exists(), "what is left is done here"


def test_ctrl_c_ends_both(cold, jobs):
    kernel, started = cold
    with pytest.raises(KeyboardInterrupt):
        compiled.compile_together([kernel], jobs("interrupted", "interrupted"))
    assert started[0].returncode is not None
    assert gc.isenabled()


def test_there_is_one_process_where_nothing_is_to_be_compiled_or_can_be_kept(cold, jobs, monkeypatch):
    kernel, started = cold
    never = jobs("interrupted")
    compiled.compile_together([kernel, rasteriser.interpolated.py_func], never)  # no cache
    kernel._cache._cache_file._load_index = lambda: {"a": "signature"}
    compiled.compile_together([kernel], never)
    kernel._cache._cache_file._load_index = dict
    monkeypatch.setattr(sys, "executable", "/usr/bin/blender")
    compiled.compile_together([kernel], never)
    assert not started


ORPHAN = """
import os
os.environ["PARENT"] = str(os.getpid())
os.cpu_count = lambda: 2
from types import SimpleNamespace
from safe_ompl.common import compilation
kernel = SimpleNamespace(_cache=SimpleNamespace(_cache_file=SimpleNamespace(_load_index=lambda: {})))
compilation.kept = lambda kernel: {}
compilation.compile_together([kernel], ["jobs:dies", "jobs:dies"])
"""


def test_the_other_process_ends_with_this_one_however_that_ends(jobs, tmp_path):
    paths = os.pathsep.join([str(Path(safe_ompl.__file__).parents[1]), str(tmp_path)])
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run([sys.executable, "-c", ORPHAN], env=environment, capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    number, end = int((tmp_path / "there").read_text()), perf_counter() + 30.0
    while _runs(number) and perf_counter() < end:
        sleep(0.01)
    assert not _runs(number)


def _runs(number):
    """Whether a process runs; one that has ended may wait to be noticed by its parent."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False
