"""Frames of folders and videos, whole or damaged."""

import struct

import cv2
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import endolab as el
from endolab.io.images import write_image
from endolab.io.video import is_sequence, open_frames, write_video


@pytest.fixture
def pictures(rng):
    return [np.round(rng.random((24, 32, 3)) * 255) / 255 for _ in range(12)]


def test_a_video_keeps_every_value_and_some_frames_can_be_chosen(pictures, tmp_path):
    write_video(tmp_path / "v.mkv", pictures)
    frames = open_frames(tmp_path / "v.mkv")
    assert frames.names == tuple(f"{n:06d}" for n in range(12))
    for (_, image), picture in zip(frames, pictures, strict=True):
        assert_allclose(image, picture, atol=1e-9)
    got = dict(frames.read(["000003", "000007"]))
    assert list(got) == ["000003", "000007"]
    assert_allclose(got["000007"], pictures[7], atol=1e-9)


def test_a_folder_is_read_in_the_order_of_its_numbers_and_a_broken_picture_is_none(
    tmp_path, pictures
):
    for number in (10, 9, 1):
        write_image(tmp_path / f"frame_{number}.png", pictures[number])
    (tmp_path / "frame_2.png").write_bytes(b"not a picture")
    (tmp_path / "frame_3.png").symlink_to(tmp_path / "nowhere.png")
    (tmp_path / "._frame_1.png").write_bytes(b"as macOS leaves it")
    (tmp_path / "notes.txt").write_text("not a picture")
    (tmp_path / "folder.png").mkdir()
    directory = bytes(128) + b"DICM" + b"1.2.840.10008.1.3.10"
    (tmp_path / "DICOMDIR").write_bytes(directory)
    frames = open_frames(tmp_path)
    assert frames.names == tuple(f"frame_{number}.png" for number in (1, 2, 3, 9, 10))
    images = [image for _, image in frames]
    assert "frame_2.png: not a whole picture" in str(images[1])
    assert "frame_3.png: there is no such file" in str(images[2])
    assert_allclose(images[0], pictures[1], atol=1e-9)


@pytest.mark.parametrize("kind", ["a.tif", "16.tif"])
def test_the_pages_of_a_file_are_frames(tmp_path, rng, kind):
    deep = rng.integers(0, 9, (3, 24, 32, 3)) * 8000
    path = tmp_path / kind
    if kind == "16.tif":
        tifffile.imwrite(path, deep.astype(np.uint16), photometric="rgb")
    else:
        first, *more = (Image.fromarray((one // 256).astype(np.uint8)) for one in deep)
        first.save(path, save_all=True, append_images=more)
    assert is_sequence(path)
    frames = open_frames(path)
    images = [image for _, image in frames]
    assert_allclose(images, deep / 65535, atol=0.01)
    assert_array_equal(dict(frames.read(["000001"]))["000001"], images[1])
    assert_allclose([*frames.times.values()], [0, np.nan, np.nan])


def test_pictures_that_are_named_are_told_apart_wherever_they_lie(tmp_path, pictures):
    places = ["a/2.png", "a/10.png", "b/2.png"]
    for number, place in enumerate(places):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        write_image(tmp_path / place, pictures[number])
    frames = open_frames(*(tmp_path / place for place in reversed(places)))
    assert (frames.path, frames.names) == (tmp_path, tuple(places))
    for (_, image), picture in zip(frames, pictures, strict=False):
        assert_allclose(image, picture, atol=1e-9)


def write_numbered(path, code, rate=25.0):
    """A video whose thirty frames count themselves: a bright bar, 8 px longer in each."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), rate, (320, 64))
    assert writer.isOpened()
    for number in range(30):
        shot = np.full((64, 320, 3), 20, np.uint8)
        shot[:16, : 8 * number] = 220
        writer.write(shot)
    writer.release()
    return bytearray(path.read_bytes())


def numbers_in(path):
    """The numbers that frames count; the bar is at the top left, unless they were turned."""
    return [
        None
        if isinstance(image, ValueError)
        else round(np.sum(image[8].mean(axis=-1) > 0.5) / 8)
        for _, image in open_frames(path)
    ]


@pytest.mark.parametrize(("transfer", "named"), [(1, ""), (16, "PQ"), (18, "HLG")])
def test_values_that_are_no_power_of_the_light_are_named(
    tmp_path, caplog, transfer, named
):
    write_numbered(tmp_path / "v.mp4", "mp4v")
    with (tmp_path / "v.mp4").open("ab") as file:
        head = struct.pack(">I", 19) + b"colrnclx"
        file.write(head + struct.pack(">HHHB", 9, transfer, 9, 0))
    assert len(open_frames(tmp_path / "v.mp4").names) == 30
    assert bool(caplog.text) is bool(named)
    assert named in caplog.text


def at_another_rate(content):
    """A Matroska file whose header says 10 frames/s, whatever its frames are timed at."""
    place = content.index(b"\x23\xe3\x83\x84") + 4
    return content[:place] + struct.pack(">I", 100_000_000) + content[place + 4 :]


def with_seven(content):
    """An AVI file whose header says it has seven frames."""
    place = content.index(b"strh") + 40
    return content[:place] + struct.pack("<I", 7) + content[place + 4 :]


@pytest.mark.parametrize(
    ("name", "code", "rate", "change", "count"),
    [
        ("v.mpg", "MPG2", 30.0, lambda content: 2 * content, 60),
        ("v.ts", "MPG2", 25.0, lambda content: 2 * content, 60),
        ("v.flv", "FLV1", 25.0, bytes, 30),
        ("v.mkv", "mp4v", 30.0, at_another_rate, 30),
        ("v.mkv", "VP80", 1000.0, bytes, 30),
        ("v.avi", "MJPG", 25.0, with_seven, 30),
    ],
)
def test_the_frames_of_a_video_are_those_that_can_be_decoded(
    tmp_path, name, code, rate, change, count
):
    """Whatever its header estimates: none is lost, and none promised that never was."""
    content = write_numbered(tmp_path / name, code, rate=rate)
    (tmp_path / name).write_bytes(change(content))
    assert numbers_in(tmp_path / name) == [*range(30)] * (count // 30)


def test_the_frames_of_a_video_have_their_times(tmp_path):
    write_numbered(tmp_path / "v.mp4", "mp4v")
    times = [*open_frames(tmp_path / "v.mp4").times.values()]
    assert_allclose(times, np.arange(30) / 25, atol=1e-6)


@pytest.mark.parametrize("matrix", [(0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0)])
def test_a_video_marked_as_turned_is_read_as_the_sensor_saw_it(
    tmp_path, caplog, matrix
):
    path = tmp_path / "v.mp4"
    content = write_numbered(path, "mp4v")
    a, b, c, d = (65536 * number for number in matrix)
    struct.pack_into(">6i", content, content.index(b"tkhd") + 44, a, b, 0, c, d, 0)
    path.write_bytes(content)
    assert numbers_in(path) == [*range(30)]
    assert "v.mp4 is marked to be shown turned" in caplog.text


def test_pixels_become_square_unless_the_calibration_is_of_those_stored(
    tmp_path, caplog
):
    path = tmp_path / "v.mpg"
    content = write_numbered(path, "MPG2")
    # Of MPEG-2: a picture of 4:3, so that 320 x 64 px are 3.75 times as high as wide.
    place = content.find(b"\0\0\1\xb3") + 7
    while place > 7:
        content[place] = 0x20 | (content[place] & 15)
        place = content.find(b"\0\0\1\xb3", place) + 7
    path.write_bytes(content)
    assert next(iter(open_frames(path)))[1].shape == (240, 320, 3)
    assert "320x240" in caplog.text
    stored = el.Calibration(el.Pinhole(320, 64, 200, 200, 160, 32))
    assert next(iter(open_frames(path, calibration=stored)))[1].shape == (64, 320, 3)


def test_what_is_damaged_in_the_middle_of_a_video_shifts_no_names(tmp_path):
    content = write_numbered(tmp_path / "v.mov", "MJPG")
    ends = range(len(content) - 3)
    starts = [at for at in ends if content[at : at + 3] == b"\xff\xd8\xff"]
    content[starts[9] : starts[11]] = bytes(starts[11] - starts[9])
    (tmp_path / "v.mov").write_bytes(content)
    expected = [*range(9), None, None, *range(11, 30)]
    assert numbers_in(tmp_path / "v.mov") == expected


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize(("name", "code"), [("v.mkv", "FFV1"), ("v.avi", "MJPG")])
def test_a_video_that_is_cut_off_is_refused(tmp_path, name, code, share):
    content = write_numbered(tmp_path / name, code)
    (tmp_path / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(ValueError, match=rf"{name}: .*30.* cut off"):
        open_frames(tmp_path / name)


@pytest.mark.parametrize("name", ["v.MTS", "video_0001", "v.mjpeg"])
def test_a_video_is_known_by_what_it_is_whatever_its_name(tmp_path, name):
    content = write_numbered(tmp_path / "v.avi", "MJPG")
    # A raw stream is pictures, one after the other.
    place = content.index(b"\xff\xd8\xff") if name == "v.mjpeg" else 0
    (tmp_path / name).write_bytes(content[place:])
    assert is_sequence(tmp_path / name)
    assert len(open_frames(tmp_path / name)) == 30
