"""DICOM pictures that pydicom writes, of every layout."""

import io

import numpy as np
import pydicom
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from pydicom import uid

import endolab as el
from endolab._extras import MissingPackage
from endolab.io.images import read_image
from endolab.io.video import is_sequence, open_frames

SMOOTH = np.add.outer(np.arange(64), np.arange(48)) + 60  # to 170
COLOURS = np.dstack([SMOOTH + 40, SMOOTH, SMOOTH - 40]).astype(np.uint8)


def write(path, pixels, colours="RGB", bits=8, compression=None, **tags):
    """Write a VL endoscopic picture; what is compressed at all is a JPEG."""
    data = pydicom.Dataset()
    data.file_meta = pydicom.dataset.FileMetaDataset()
    data.file_meta.TransferSyntaxUID = uid.ExplicitVRLittleEndian
    data.SOPClassUID = uid.VLEndoscopicImageStorage
    data.set_pixel_data(pixels, colours, bits)
    if compression:
        data.file_meta.TransferSyntaxUID = compression
        stream = io.BytesIO()
        Image.fromarray(pixels).save(stream, "JPEG", quality=95)
        data.PixelData = pydicom.encaps.encapsulate([stream.getvalue()])
    for name, value in tags.items():
        setattr(data, name, value)
    data.save_as(path, enforce_file_format=True)
    return path


@pytest.mark.parametrize("compression", [None, uid.JPEGBaseline8Bit])
@pytest.mark.parametrize("colours", ["RGB", "YBR_FULL", "MONOCHROME2", "MONOCHROME1"])
def test_a_dicom_picture_is_read_in_its_colours(tmp_path, compression, colours):
    seen = stored = COLOURS if colours in ("RGB", "YBR_FULL") else COLOURS[..., 1]
    if colours == "MONOCHROME1":
        stored = 255 - seen
    if colours == "YBR_FULL" and compression is None:
        stored = np.asarray(Image.fromarray(seen).convert("YCbCr"))
    path = write(tmp_path / "IM0001", stored, colours, compression=compression)
    assert not is_sequence(path)
    assert_allclose(el.read_frame(path).image * 255, seen, atol=6)


@pytest.mark.parametrize("implicit", [True, False])
def test_a_folder_of_files_without_preamble_or_suffix_is_read(tmp_path, implicit):
    whole = pydicom.dcmread(write(tmp_path / "a.dcm", COLOURS))
    (tmp_path / "a.dcm").unlink()
    plain = {
        "implicit_vr": implicit,
        "little_endian": True,
        "enforce_file_format": False,
    }
    del whole.file_meta, whole.preamble
    for name in ("1.2.840.1", "IM2"):
        whole.save_as(tmp_path / name, **plain)
    assert not is_sequence(tmp_path / "IM2")
    assert_allclose([255 * image for _, image in open_frames(tmp_path)], [COLOURS] * 2)


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_all_its_bits_are_read(tmp_path, rng, bits):
    stored = rng.integers(0, 2**bits, (6, 8)).astype(np.uint16)
    found = read_image(write(tmp_path / "a.dcm", stored, "MONOCHROME2", bits))
    assert_allclose(found, stored / (2**bits - 1), atol=1e-5)


@pytest.mark.parametrize(
    ("tags", "times"),
    [
        ({"FrameTime": "40"}, [0, 0.04, 0.08]),
        ({"FrameTimeVector": ["0", "40", "20"]}, [0, 0.04, 0.06]),
        ({"CineRate": "25"}, [0, 0.04, 0.08]),
        ({}, [0, np.nan, np.nan]),
    ],
)
def test_several_frames_have_their_times(tmp_path, tags, times):
    stored = np.stack([COLOURS, COLOURS // 2, COLOURS // 3])
    frames = open_frames(write(tmp_path / "a.dcm", stored, **tags))
    assert_allclose([*frames.times.values()], times)
    assert_allclose([image * 255 for _, image in frames], stored)


def test_pixels_become_square(tmp_path, caplog):
    path = write(tmp_path / "a.dcm", COLOURS, PixelAspectRatio=["3", "2"])
    assert read_image(path).shape == (96, 48, 3)
    assert "48x96" in caplog.text
    known = el.Calibration(el.Pinhole(48, 64, 40, 40, 24, 32))
    assert read_image(path, 0, known).shape == (64, 48, 3)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"compression": uid.JPEGLosslessSV1}, "JPEG Lossless"),
        ({"compression": uid.MPEG4HP41}, "MPEG-4"),
        ({"colours": "PALETTE COLOR"}, "not a whole DICOM picture"),
        ({"PixelRepresentation": 1}, "not a whole DICOM picture"),
        ({"Rows": 640}, "not a whole DICOM picture"),
    ],
)
def test_what_is_not_read_is_said_in_one_sentence(tmp_path, change, word):
    how = {"colours": "MONOCHROME2"} | change
    path = write(tmp_path / "a.dcm", COLOURS[..., 0], **how)
    with pytest.raises(ValueError, match=rf"^[^\n]*a\.dcm: [^\n]*{word}[^\n]*$"):
        read_image(path)


def test_without_pydicom_one_sentence_says_so(tmp_path, monkeypatch):
    path = write(tmp_path / "a.dcm", COLOURS)
    monkeypatch.setattr("endolab._extras.find_spec", lambda name: None)
    with pytest.raises(MissingPackage, match=r"endolab\[dicom\]"):
        el.read_frame(path)
