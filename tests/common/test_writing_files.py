"""Files are written as a whole, or stay what they were."""

import os
from pathlib import Path

import pytest

from safe_ompl.common import files


def listed(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_replaced_as_a_whole(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("before")
    file.chmod(0o640)
    (tmp_path / "link").symlink_to(file)
    with files.replacing(tmp_path / "link") as stream:
        stream.write("after\n")
        stream.flush()
        assert file.read_text() == "before"
    assert file.read_bytes() == b"after\n"
    assert file.stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "link").is_symlink()
    assert listed(tmp_path) == ["a.txt", "link"]


def test_what_fails_leaves_what_was_there(tmp_path):
    file = tmp_path / "a.txt"
    files.write(file, b"before")
    with pytest.raises(FileNotFoundError, match="elsewhere"), files.replacing(file) as stream:
        print("half", (tmp_path / "elsewhere").read_text(), file=stream)
    assert (file.read_text(), listed(tmp_path)) == ("before", ["a.txt"])


def test_errors_name_the_file(tmp_path):
    for file in (tmp_path / "no" / "a.txt", tmp_path):
        with pytest.raises(OSError, match=r"No such file|Is a directory") as raised:
            files.write(file, "x")
        assert raised.value.filename == str(file)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a full disk")
def test_a_full_disk_is_named():
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
        files.write("/dev/full", "x")


def test_pipes_are_written_directly(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    files.write(pipe, "through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)
    assert pipe.is_fifo()


@pytest.mark.parametrize(
    "text", ["1e3", ".5e-3", "no", "On", "0x10", "12:30", "null", "~", "=", "<<", "a: b", "x #y", ""]
)
def test_text_stays_text(text):
    data = {"name": text, "rows": [[text, [1.0, 2.0]]], **({text: 1.0} if text else {})}
    for written in (files.dump_document(data), files.dump_document(data, flow=None), files.dump_line(data)):
        assert files.parse_document(written) == data
    assert "\n" not in files.dump_line(data)
    assert files.parse_document(f"key: {files.dump_line(text)}") == {"key": text}
