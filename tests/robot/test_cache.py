"""The cache on disk: where it is, what is read back, and that it never gets in the way."""

import logging
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from safe_ompl.common import cache


def test_values_come_back(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "deep" / "folder"))
    assert cache.read("pairs", "abc") is None
    cache.write("pairs", "abc", [1, 2])
    assert cache.read("pairs", "abc") == [1, 2]
    assert cache.read("pairs", "abd") is None
    assert cache.read("other", "abc") is None


def test_it_can_be_switched_off(monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, "off")
    assert cache.cache_folder() is None
    cache.write("pairs", "abc", [1])
    assert cache.read("pairs", "abc") is None


@pytest.mark.skipif(sys.platform != "linux", reason="the folder of Linux")
def test_it_follows_the_conventions(monkeypatch, tmp_path):
    monkeypatch.delenv(cache.VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.cache_folder() == tmp_path / "safe-ompl"
    for none in ("", "relative/path"):
        monkeypatch.setenv("XDG_CACHE_HOME", none)
        assert cache.cache_folder() == Path.home() / ".cache" / "safe-ompl"


def test_a_folder_that_cannot_be_written_is_only_logged(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "file"))
    with caplog.at_level(logging.INFO):
        cache.write("pairs", "abc", [1])
        assert cache.read("pairs", "abc") is None
    assert "cannot be written" in caplog.text


def test_many_writers_leave_one_whole_file(tmp_path, monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path))
    value = list(range(5000))
    with ThreadPoolExecutor(4) as pool:
        jobs = [pool.submit(cache.write, "pairs", "abc", value) for _ in range(20)]
        seen = [cache.read("pairs", "abc") for _ in range(50)]
        for job in jobs:
            job.result()
    assert all(found is None or found == value for found in seen)
    assert [file.name for file in tmp_path.iterdir()] == ["pairs-abc.json"]
