"""Files that are written whole or not at all."""

import os
import stat

import numpy as np
import pytest

import softrod_jax as sr
from calibration import write_log
from softrod_jax.foundation.whole_files import whole_file


def test_a_full_disk_leaves_what_was_there(tmp_path):
    path = tmp_path / "motion.csv"
    path.write_text("before")
    with pytest.raises(OSError) as error, whole_file(path) as file:
        file.write("half of it")
        file.flush()
        raise OSError(28, "No space left on device")
    assert error.value.filename == str(path)
    assert path.read_text() == "before"
    assert os.listdir(tmp_path) == ["motion.csv"]


def test_keeps_permissions_and_links(tmp_path):
    path, link = tmp_path / "a.txt", tmp_path / "b.txt"
    path.write_text("before")
    path.chmod(0o640)
    link.symlink_to(path)
    with whole_file(link) as file:
        file.write("after")
    assert link.is_symlink() and path.read_text() == "after"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_what_is_no_file_is_written_as_it_is(tmp_path):
    with whole_file(os.devnull) as file:
        file.write("nothing")
    assert not os.path.isfile(os.devnull)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
def test_logs_and_scenes_name_the_file_that_could_not_be_written():
    for write in (
        lambda path: write_log(path, np.arange(1e4)),
        lambda path: sr.save_scene(sr.hybrid_robot(), path),
    ):
        with pytest.raises(OSError, match="No space left") as error:
            write("/dev/full")
        assert error.value.filename == "/dev/full"


def test_a_log_is_not_half_written(tmp_path):
    path = tmp_path / "log.csv"
    write_log(path, [0.0, 1.0])
    before = path.read_text()
    with pytest.raises(ValueError, match="dimensions"):
        write_log(path, [0.0, 1.0], np.zeros((3, 2)))
    assert path.read_text() == before and os.listdir(tmp_path) == ["log.csv"]
