"""Damaged files: every reader takes them or refuses them in one sentence, in bounded memory."""

import contextlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import psutil
import pytest
from hypothesis import given as tried
from hypothesis import settings
from hypothesis import strategies as st

import endolab as el
from endolab.io.datasets import traced
from endolab.io.datasets.published import true_z
from endolab.io.depth_maps import read_depth_map
from endolab.io.descriptions import read_target
from endolab.io.images import read_image, read_mask
from endolab.io.settings import read_settings
from endolab.io.surfaces import read_depth
from tests.hostile.conftest import CALIBRATIONS, EXAMPLES, run, sentences
from tests.hostile.damage import damaged_arrays, damaged_bytes, damaged_json

MOST_MEMORY = 600  # MB that reading a small file may take
READERS = {
    "mask.png": read_mask,
    "0042_depth.png": true_z,
    "video.mkv": lambda path: list(el.open_frames(path)),
    "video.avi": lambda path: list(el.open_frames(path)),
    "depth.npz": read_depth,
    "other.npz": read_depth_map,
    "other.npy": read_depth_map,
    "other.tiff": read_depth_map,
    "traced.npz": traced.read,
    "endoscope.json": el.load_calibration,
    "target.json": read_target,
    "settings.json": read_settings,
}
READERS |= dict.fromkeys(("frame.png", "deep.png", "frame.jpg"), read_image)
READERS |= dict.fromkeys(CALIBRATIONS, el.load_calibration)


def damages(path):
    """Damages of a file, from without or, where its format is known, from within."""
    ways = {".npz": damaged_arrays, ".json": damaged_json}
    return st.one_of(damaged_bytes(path), ways.get(path.suffix, damaged_bytes)(path))


@pytest.mark.parametrize("name", READERS)
def test_what_is_damaged_is_taken_or_refused_in_one_sentence(name, given, tmp_path):
    path = tmp_path / name
    READERS[name](Path(shutil.copy(given / name, path)))  # undamaged

    @tried(damages(given / name))
    def attack(content):
        path.write_bytes(content)
        with contextlib.suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5")
        before = psutil.Process().memory_info().rss / 2**20
        try:
            READERS[name](path)
        except (ValueError, OSError, MemoryError) as error:
            assert str(path) in str(error)  # noqa: PT017
            assert "\n" not in str(error)  # noqa: PT017
        status = Path("/proc/self/status")
        if status.exists():
            peak = int(re.search(r"VmHWM:\s+(\d+)", status.read_text())[1]) / 1024
            assert peak - before < MOST_MEMORY

    attack()


def test_a_nan_that_signals_is_read_without_a_warning(tmp_path):
    signals = np.full((4, 4), 0x7FA00000, np.uint32)
    signals[:2] = np.float32(30).view(np.uint32)
    np.save(tmp_path / "depth.npy", signals.view(np.float32))
    assert np.isnan(read_depth_map(tmp_path / "depth.npy").values[2:]).all()


@pytest.mark.parametrize("name", ["frames.csv", "report.json", "frames/5/depth.npz"])
def test_a_video_goes_on_from_damaged_results_or_refuses_them(
    name, given, tmp_path, capfd
):
    words = f"reconstruct pictures --calibration endoscope.json --solver facing --out {tmp_path}"

    @settings(max_examples=max(EXAMPLES // 4, 1))
    @tried(damages(given / "video" / name))
    def attack(content):
        shutil.rmtree(tmp_path / "video", ignore_errors=True)
        shutil.copytree(given / "video", tmp_path / "video")
        (tmp_path / "video" / name).write_bytes(content)
        with contextlib.chdir(given):
            status = run(f"{words}/video")
        output = capfd.readouterr().err
        assert (status, len(sentences(output))) in ((0, 0), (2, 1)), output
        if status == 0:
            report = json.loads((tmp_path / "video/report.json").read_text())
            assert report["done"] == 6

    attack()
