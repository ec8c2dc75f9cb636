"""Frames of folders, videos and streams, whole or broken."""

import http.server
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from endolab.io.images import write_image
from endolab.io.video import is_sequence, is_stream, open_frames, open_stream, write_video

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def pictures(rng):
    return [np.round(rng.random((24, 32, 3)) * 255) / 255 for _ in range(12)]


@pytest.fixture
def video(pictures, tmp_path):
    write_video(tmp_path / "v.mkv", pictures, rate=40.0)
    return tmp_path / "v.mkv"


def test_a_video_keeps_every_value_and_some_frames_can_be_chosen(video, pictures, tmp_path):
    frames = open_frames(video)
    assert frames.names == tuple(f"{n:06d}" for n in range(12))
    for (_, image), picture in zip(frames, pictures, strict=True):
        np.testing.assert_allclose(image, picture, atol=1e-9)
    got = list(open_frames(video).read(["000003", "000007"]))
    assert [name for name, _ in got] == ["000003", "000007"]
    np.testing.assert_allclose(got[1][1], pictures[7], atol=1e-9)
    write_video(tmp_path / "g.mkv", [pictures[0][..., 0]])
    grey = next(iter(open_frames(tmp_path / "g.mkv")))[1]
    np.testing.assert_allclose(grey, pictures[0][..., :1].repeat(3, -1), atol=1e-9)


def test_a_folder_is_read_in_the_order_of_its_numbers_and_a_broken_picture_is_none(tmp_path, pictures):
    for number in (10, 9, 1):
        write_image(tmp_path / f"frame_{number}.png", pictures[number])
    (tmp_path / "frame_2.png").write_bytes(b"not a picture")
    (tmp_path / "frame_3.png").symlink_to(tmp_path / "nowhere.png")
    (tmp_path / "._frame_1.png").write_bytes(b"as macOS leaves it")
    (tmp_path / "notes.txt").write_text("not a picture")
    (tmp_path / "folder.png").mkdir()
    frames = open_frames(tmp_path)
    assert frames.names == tuple(f"frame_{number}.png" for number in (1, 2, 3, 9, 10))
    images = [image for _, image in frames]
    assert [image is None for image in images] == [False, True, True, False, False]
    np.testing.assert_allclose(images[0], pictures[1], atol=1e-9)
    assert len({tuple(stamp) for stamp in frames.stamp}) == 5


def test_pictures_that_are_named_are_told_apart_wherever_they_lie(tmp_path, pictures):
    places = ["a/2.png", "a/10.png", "b/2.png"]
    for number, place in enumerate(places):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        write_image(tmp_path / place, pictures[number])
    frames = open_frames(*(tmp_path / place for place in reversed(places)))
    assert (frames.path, frames.names) == (tmp_path, tuple(places))
    for (_, image), picture in zip(frames, pictures, strict=False):
        np.testing.assert_allclose(image, picture, atol=1e-9)
    together = open_frames(tmp_path / "a/2.png", tmp_path / "a/10.png")
    assert together == open_frames(tmp_path / "a")  # so that either call goes on from the other
    assert open_frames(tmp_path / "a/2.png").names == ("2.png",)
    for other in ("a", "none.png"):
        with pytest.raises(ValueError, match=other):
            open_frames(tmp_path / "a/2.png", tmp_path / other)


def test_a_video_that_ends_early_gives_none_for_what_it_lacks(video, tmp_path):
    content = video.read_bytes()
    video.write_bytes(content[: len(content) // 2])
    there = [image is not None for _, image in open_frames(video)]
    assert set(there) == {True, False}
    assert there == sorted(there, reverse=True)


def test_a_video_is_written_whole_or_not_at_all(tmp_path, pictures):
    def broken():
        yield pictures[0]
        raise RuntimeError("the renderer failed")

    with pytest.raises(RuntimeError):
        write_video(tmp_path / "v.mkv", broken())
    with pytest.raises(ValueError, match="mp4"):
        write_video(tmp_path / "v.mp4", pictures)
    with pytest.raises(OSError, match=r"v\.mkv"):
        write_video(tmp_path / "v.mkv", [])
    with pytest.raises(ValueError, match="frame 1"):
        write_video(tmp_path / "v.mkv", [pictures[0], pictures[0][1:]])
    assert list(tmp_path.iterdir()) == []


def test_what_holds_no_frames_is_refused_and_nothing_is_printed(tmp_path, capfd):
    (tmp_path / "junk.mp4").write_bytes(b"x" * 999)
    wrong = {"none.mp4": FileNotFoundError, "": ValueError, "junk.mp4": ValueError}
    for name, error in wrong.items():
        with pytest.raises(error, match=str(tmp_path / name)):
            open_frames(tmp_path / name)
    with pytest.raises(ValueError, match="camera 99"):
        open_stream(99)
    assert capfd.readouterr().err == ""


def test_sequences_and_streams_are_known_by_what_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.png").mkdir()
    assert is_sequence(tmp_path)
    assert is_sequence("none.MP4")
    assert not is_sequence("none")
    assert not is_sequence("a.png")
    assert is_stream(0)
    assert is_stream("0")
    assert is_stream("http://127.0.0.1/x")
    assert not is_stream("0.png")
    Path("0").mkdir()
    assert not is_stream("0")


def test_a_video_larger_than_memory_is_refused_before_a_frame_is_decoded(video, monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: type("Memory", (), {"available": 10_000}))
    with pytest.raises(MemoryError, match=r"v\.mkv: a frame of 32x24 px"):
        open_frames(video)


def test_a_video_is_played_at_its_own_rate_and_can_be_ended(video, pictures):
    stream = open_stream(video)
    assert stream.rate == pytest.approx(40)
    started, at = time.perf_counter(), []
    for name, image in stream:
        np.testing.assert_allclose(image, pictures[int(name)], atol=1e-9)
        at.append(time.perf_counter() - started)
    assert len(at) == 12
    assert (np.array(at) >= np.arange(12) / 40 - 0.002).all()
    ended = open_stream(video)
    next(frames := iter(ended))
    ended.close()
    assert list(frames) == []


def test_a_stream_comes_from_a_server(video, pictures):
    content = video.read_bytes()

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *message):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        frames = list(open_stream(f"http://127.0.0.1:{server.server_address[1]}/live"))
        server.shutdown()
    assert len(frames) == 12
    np.testing.assert_allclose(frames[11][1], pictures[11], atol=1e-9)
    with pytest.raises(ValueError, match="http://127"):
        open_stream("http://127.0.0.1:9/none")
