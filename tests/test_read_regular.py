"""Files are read within limits: regular ones only, and no more of them than is asked for."""

import os

import pytest

from harness.errors import InputError
from harness.files import read_regular
from harness.io.calibrations.parsing import read_content


def refusal(path, limit_bytes=100):
    with pytest.raises(InputError) as caught:
        read_regular(path, limit_bytes, "scene")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_contents_up_to_the_limit(tmp_path):
    file = tmp_path / "a"
    file.write_bytes(b"x" * 100)
    assert read_regular(file, 100) == b"x" * 100
    assert f"{file}: is larger than the 9.44138e-05 MiB" in refusal(file, 99)
    (tmp_path / "link").symlink_to("a")
    assert read_regular(str(tmp_path / "link"), 100) == b"x" * 100


def test_an_image_for_a_sensor_is_called_one_at_any_size(tmp_path):
    file = tmp_path / "a.png"
    for size in (10, 1000):
        file.write_bytes(b"\x89PNG" + bytes(size))
        with pytest.raises(InputError, match=r"a\.png: is a PNG image; a text file is read here$"):
            read_content(file) if size == 10 else read_regular(file, 100, "sensor")
    assert read_regular(file, 1004, "sensor") == file.read_bytes()
    with pytest.raises(InputError, match="is larger than"):
        read_regular(file, 100, "image")


def test_only_regular_files(tmp_path):
    assert "no such file" in refusal(tmp_path / "none")
    assert "not a regular file" in refusal(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    assert "loop: cannot be read" in refusal(tmp_path / "loop")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert "pipe: is not a regular file" in refusal(tmp_path / "pipe")
    assert "/dev/zero: is not a regular file" in refusal("/dev/zero")


def test_names_that_are_none(tmp_path):
    assert "is not a file name" in refusal(tmp_path / "a\0b")
    assert "is not a file name" in refusal("\ud800")
    assert len(refusal(tmp_path / ("x" * 5000))) < 400
