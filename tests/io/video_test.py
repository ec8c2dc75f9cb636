"""Frames of folders and videos, whole or broken."""

import contextlib
import http.server
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from endolab.io import video as video_module
from endolab.io.images import write_image
from endolab.io.video import is_sequence, is_stream, open_frames, open_stream, write_video


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


def test_hidden_files_are_no_frames(tmp_path, pictures):
    """Such as a file that is being written, and what macOS leaves beside pictures on other disks."""
    for name in ("1.png", "._1.png", ".endolab-01234567-1-01234567.png"):
        write_image(tmp_path / name, pictures[0])
    assert open_frames(tmp_path).names == ("1.png",)


@pytest.mark.skipif(os.name != "posix", reason="limits are of POSIX")
def test_a_full_disk_leaves_no_video(tmp_path):
    """OpenCV says nothing of it; so a limit on the size of files does for a full disk."""
    code = """if True:
        import resource, signal
        import numpy as np
        from endolab.io.video import write_video
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000))
        try:
            write_video("v.mkv", np.random.default_rng(0).random((24, 120, 160, 3)))
        except OSError as error:
            print(error)
    """
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60, check=True
    )
    sentence = r"cannot write v\.mkv: only \d+ of 24 frames can be read back; the disk may be full\n"
    assert re.fullmatch(sentence, done.stdout)
    assert done.stderr == ""
    assert list(tmp_path.iterdir()) == []


def test_a_frame_that_is_not_kept_exactly_is_no_frame(tmp_path, pictures, monkeypatch):
    """As when a frame in the middle is lost, or its values are."""
    real = cv2.VideoWriter

    class Lossy:
        fourcc = real.fourcc

        def __init__(self, *how):
            self.real, self.count = real(*how), 0
            self.isOpened, self.release = self.real.isOpened, self.real.release

        def write(self, stored):
            self.count += 1
            self.real.write(stored // 2 if self.count == 6 else stored)

    monkeypatch.setattr(cv2, "VideoWriter", Lossy)
    with pytest.raises(OSError, match=r"v\.mkv: only 5 of 12 frames can be read back"):
        write_video(tmp_path / "v.mkv", pictures)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("shape", [(24, 30, 3), (24, 32), (24, 32, 4), (24,)])
def test_the_frames_of_a_video_are_of_one_size(tmp_path, pictures, shape):
    with pytest.raises(ValueError, match=r"frame 1 of a video: expected \(24, 32, 3\), found \(24"):
        write_video(tmp_path / "v.mkv", [pictures[0], np.zeros(shape)])
    assert list(tmp_path.iterdir()) == []


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


def test_a_video_of_frames_larger_than_memory_is_refused_before_one_is_decoded(video, monkeypatch):
    monkeypatch.setattr("psutil.virtual_memory", lambda: type("Memory", (), {"available": 10_000}))
    with pytest.raises(MemoryError, match=r"v\.mkv: a frame of 32x24 px needs about 0.0 GB of memory"):
        open_frames(video)


def test_what_the_decoder_does_not_give_is_none(video, monkeypatch):
    class Broken:
        """A capture that says it has done what it has not."""

        given = iter([(True, None), (True, np.zeros((0, 0), np.uint8)), (False, None)])

        def grab(self):
            return True

        def retrieve(self):
            return next(self.given)

        def release(self):
            pass

    frames = open_frames(video)
    monkeypatch.setattr(video_module, "_open", lambda path: Broken())
    assert [image for _, image in frames.read(frames.names[:3])] == [None] * 3


@pytest.mark.parametrize("said", [-1.0, 0.0, 1e18, float("nan"), float("inf")])
def test_frames_are_counted_where_the_head_cannot_be_right(video, said):
    class Boasting:
        left = 12

        def get(self, what):
            return said

        def grab(self):
            self.left -= 1
            return self.left >= 0

    assert video_module._count(Boasting(), 1000) == 12


def test_a_folder_is_no_picture_and_a_link_to_nowhere_cannot_be_read(tmp_path, pictures):
    write_image(tmp_path / "1.png", pictures[0])
    write_image(tmp_path / "\u00b2.png", pictures[0])  # a digit to some, a number to none
    (tmp_path / "2.png").mkdir()
    try:
        (tmp_path / "3.png").symlink_to(tmp_path / "nowhere.png")
    except OSError:
        pytest.skip("this system has no links")
    frames = open_frames(tmp_path)
    assert sorted(frames.names) == ["1.png", "3.png", "\u00b2.png"]
    assert dict(frames)["3.png"] is None
    assert {name: changed for name, *changed in frames.stamp}["3.png"] == [-1, -1]


class Camera:
    """What OpenCV gives for a camera: so many pictures, and then no more."""

    def __init__(self, pictures=(), opened=True):
        self.pictures, self.opened, self.released = iter(pictures), opened, False

    def isOpened(self):
        return self.opened

    def set(self, what, value):
        return True

    def get(self, what):
        return 0.0

    def read(self):
        stored = next(self.pictures, None)
        return stored is not None, stored

    def release(self):
        self.released = True


def test_a_camera_gives_what_it_sees_and_is_let_go(monkeypatch, rng):
    stored = [rng.integers(0, 256, (24, 32, 3), dtype=np.uint8) for _ in range(3)]
    camera, asked = Camera(stored), []
    monkeypatch.setattr(cv2, "VideoCapture", lambda *which: asked.append(which) or camera)
    stream = open_stream("2")
    assert (asked, stream.name, stream.rate) == ([(2,)], "camera 2", None)
    seen = list(stream)
    assert [name for name, _ in seen] == ["000000", "000001", "000002"]
    for (_, image), one in zip(seen, stored, strict=True):
        np.testing.assert_array_equal(np.round(255 * image), one[..., ::-1])
    assert camera.released


@pytest.mark.parametrize(
    ("source", "camera", "sentence"),
    [
        (0, Camera(opened=False), "camera 0 cannot be opened: it is not there, or in use"),
        ("1", Camera(), "camera 1 gives no picture"),
        (0, Camera([np.zeros((4, 4), np.uint16)]), "camera 0 gives no picture"),
        ("rtsp://127.0.0.1/x", Camera(opened=False), "rtsp://127.0.0.1/x: the stream cannot be opened"),
        ("ftp://127.0.0.1/x", None, "URLs begin with rtsp, rtmp, http"),
        ("concat:a|b", None, "there is no such video"),
    ],
)
def test_a_camera_or_stream_that_gives_nothing_is_one_sentence(monkeypatch, source, camera, sentence):
    monkeypatch.setattr(cv2, "VideoCapture", lambda *which: camera)
    with pytest.raises((ValueError, FileNotFoundError), match=re.escape(sentence)):
        list(open_stream(source))


def test_there_is_no_camera_of_that_number(capfd):
    with pytest.raises(ValueError, match="camera 99 cannot be opened"):
        open_stream(99)
    assert capfd.readouterr().err == ""


def test_a_video_is_played_at_its_own_rate_and_can_be_ended(tmp_path, pictures):
    write_video(tmp_path / "v.mkv", pictures, rate=40.0)
    stream = open_stream(tmp_path / "v.mkv")
    assert stream.rate == pytest.approx(40)
    started, at = time.perf_counter(), []
    for name, image in stream:
        np.testing.assert_allclose(image, pictures[int(name)], atol=1e-9)
        at.append(time.perf_counter() - started)
    assert len(at) == 12
    assert (np.array(at) >= np.arange(12) / 40 - 0.002).all()
    ended = open_stream(tmp_path / "v.mkv")
    next(frames := iter(ended))
    ended.close()
    assert list(frames) == []


@contextlib.contextmanager
def served(content, kind="application/octet-stream"):
    """The address of a server on this machine that sends these bytes."""

    class Answer(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.end_headers()
            with contextlib.suppress(OSError):
                self.wfile.write(content)

        def log_message(self, *said):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Answer) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/live"
        finally:
            server.shutdown()


def motion_jpeg(pictures):
    """Frames as cameras on a network send them: JPEG after JPEG."""
    stored = [np.round(255 * picture).astype(np.uint8)[..., ::-1] for picture in pictures]
    parts = [cv2.imencode(".jpg", one, (cv2.IMWRITE_JPEG_QUALITY, 95))[1].tobytes() for one in stored]
    head = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n"
    return b"".join(head % len(part) + part + b"\r\n" for part in parts) + b"--frame--\r\n"


def test_a_stream_comes_from_a_server(video, pictures):
    with served(video.read_bytes()) as address:
        frames = list(open_stream(address))
    assert len(frames) == 12
    np.testing.assert_allclose(frames[11][1], pictures[11], atol=1e-9)


def test_a_stream_of_jpegs_comes_from_a_server(rng):
    smooth = [cv2.GaussianBlur(rng.random((48, 64, 3)), (0, 0), 4) for _ in range(5)]
    with served(motion_jpeg(smooth), "multipart/x-mixed-replace; boundary=frame") as address:
        frames = list(open_stream(address))
    assert len(frames) == 5
    assert np.abs(frames[3][1] - smooth[3]).mean() < 0.02


def test_a_url_may_name_a_file(video):
    assert len(list(open_stream(f"file://{video}"))) == 12


def test_what_is_a_stream_is_known_by_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert is_stream(0)
    assert is_stream("0")
    assert is_stream("http://127.0.0.1/x")
    assert not is_stream("0.png")
    assert not is_stream(tmp_path / "video.mp4")
    (tmp_path / "0").mkdir()
    assert not is_stream("0")
    with pytest.raises(ValueError, match="0 is a folder: a live view takes a camera, a stream or a video"):
        open_stream("0")
