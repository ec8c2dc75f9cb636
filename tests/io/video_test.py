"""Frames of folders and videos, whole or broken."""

import numpy as np
import pytest

from endolab.io.images import write_image
from endolab.io.video import is_sequence, open_frames, write_video


@pytest.fixture
def pictures(rng):
    return [np.round(rng.random((24, 32, 3)) * 255) / 255 for _ in range(12)]


@pytest.fixture
def video(pictures, tmp_path):
    write_video(tmp_path / "v.mkv", pictures)
    return tmp_path / "v.mkv"


def test_a_video_keeps_every_value_and_some_frames_can_be_chosen(video, pictures):
    frames = open_frames(video)
    assert frames.is_video
    assert frames.names == tuple(f"{n:06d}" for n in range(12))
    for (_, image), picture in zip(frames, pictures, strict=True):
        np.testing.assert_array_equal(np.round(image * 255), np.round(picture * 255))
    got = list(open_frames(video).read(["000003", "000007"]))
    assert [name for name, _ in got] == ["000003", "000007"]
    np.testing.assert_allclose(got[1][1], pictures[7], atol=1e-9)


def test_a_grey_video_is_grey_in_every_channel(tmp_path, rng):
    grey = rng.random((16, 16))
    write_video(tmp_path / "g.mkv", [grey])
    image = next(iter(open_frames(tmp_path / "g.mkv")))[1]
    np.testing.assert_allclose(image, grey[..., None].repeat(3, -1), atol=0.51 / 255)


def test_a_folder_is_read_in_the_order_of_its_numbers_and_a_broken_picture_is_none(tmp_path, pictures):
    for number in (10, 9, 1):
        write_image(tmp_path / f"frame_{number}.png", pictures[number])
    (tmp_path / "frame_2.png").write_bytes(b"not a picture")
    (tmp_path / "notes.txt").write_text("not a picture")
    frames = open_frames(tmp_path)
    assert frames.names == ("frame_1.png", "frame_2.png", "frame_9.png", "frame_10.png")
    assert not frames.is_video
    images = [image for _, image in frames]
    assert [image is None for image in images] == [False, True, False, False]
    np.testing.assert_allclose(images[0], pictures[1], atol=1e-9)


def test_pictures_that_are_named_are_told_apart_wherever_they_lie(tmp_path, pictures):
    places = ["a/2.png", "a/10.png", "b/2.png"]
    for number, place in enumerate(places):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        write_image(tmp_path / place, pictures[number])
    frames = open_frames(*(tmp_path / place for place in reversed(places)))
    assert (frames.path, frames.names, frames.is_video) == (tmp_path, tuple(places), False)
    assert len({tuple(stamp) for stamp in frames.stamp}) == 3
    for (name, image), picture in zip(frames, pictures, strict=False):
        np.testing.assert_allclose(image, picture, atol=1e-9, err_msg=name)
    together = open_frames(tmp_path / "a/2.png", tmp_path / "a/10.png")
    assert together == open_frames(tmp_path / "a")  # so that either call goes on from the other
    assert open_frames(tmp_path / "a/2.png").names == ("2.png",)


def test_a_video_that_ends_early_gives_none_for_what_it_lacks(video, tmp_path):
    content = video.read_bytes()
    short = tmp_path / "short.mkv"
    short.write_bytes(content[: len(content) // 2])
    there = [image is not None for _, image in open_frames(short)]
    assert set(there) == {True, False}
    assert there == sorted(there, reverse=True)


@pytest.mark.parametrize(
    ("make", "error", "sentence"),
    [
        (lambda folder: folder / "none.mp4", FileNotFoundError, "there is no such folder or video"),
        (lambda folder: folder, ValueError, "no picture in this folder"),
        (lambda folder: folder / "junk.mp4", ValueError, "not a video"),
    ],
)
def test_what_holds_no_frames_is_refused(tmp_path, make, error, sentence, capfd):
    path = make(tmp_path)
    if path.name == "junk.mp4":
        path.write_bytes(b"x" * 999)
    with pytest.raises(error, match=sentence):
        open_frames(path)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("others", "error", "sentence"),
    [
        (
            ["v.mkv"],
            ValueError,
            "v.mkv is no picture by its name: give one folder, one video, or pictures alone",
        ),
        (["folder"], ValueError, "folder is a folder: give one folder"),
        (["none.png"], FileNotFoundError, "none.png: there is no such file"),
        (["folder/../a.png"], ValueError, "a.png is given twice"),
    ],
)
def test_pictures_go_with_pictures_alone(tmp_path, video, pictures, others, error, sentence):
    (tmp_path / "folder").mkdir()
    write_image(tmp_path / "a.png", pictures[0])
    with pytest.raises(error, match=sentence):
        open_frames(tmp_path / "a.png", *(tmp_path / other for other in others))
    with pytest.raises(ValueError, match="give a folder, a video, or pictures"):
        open_frames()


def test_a_video_is_written_whole_or_not_at_all(tmp_path, pictures):
    def broken():
        yield pictures[0]
        raise RuntimeError("the renderer failed")

    with pytest.raises(RuntimeError):
        write_video(tmp_path / "v.mkv", broken())
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match=r"ends in \.mkv, got v\.mp4"):
        write_video(tmp_path / "v.mp4", pictures)
    with pytest.raises(ValueError, match="there is no frame"):
        write_video(tmp_path / "v.mkv", [])


def test_a_sequence_is_known_by_what_it_is(tmp_path):
    (tmp_path / "a.png").mkdir()
    assert is_sequence(tmp_path)
    assert is_sequence("none.MP4")
    assert not is_sequence("none")
    assert not is_sequence(tmp_path / "a.png")
