"""Frames of folders, videos and streams, whole or broken."""

import http.server
import struct
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from endolab.cli.main import main
from endolab.io.images import read_image, write_image
from endolab.io.video import (
    is_sequence,
    is_stream,
    open_frames,
    open_stream,
    write_video,
)

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def pictures(rng):
    return [np.round(rng.random((24, 32, 3)) * 255) / 255 for _ in range(12)]


@pytest.fixture
def video(pictures, tmp_path):
    write_video(tmp_path / "v.mkv", pictures, rate=40.0)
    return tmp_path / "v.mkv"


def test_a_video_keeps_every_value_and_some_frames_can_be_chosen(
    video, pictures, tmp_path
):
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
    frames = open_frames(tmp_path)
    assert frames.names == tuple(f"frame_{number}.png" for number in (1, 2, 3, 9, 10))
    images = [image for _, image in frames]
    assert [image is None for image in images] == [False, True, True, False, False]
    np.testing.assert_allclose(images[0], pictures[1], atol=1e-9)


def test_pictures_that_are_named_are_told_apart_wherever_they_lie(tmp_path, pictures):
    places = ["a/2.png", "a/10.png", "b/2.png"]
    for number, place in enumerate(places):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        write_image(tmp_path / place, pictures[number])
    frames = open_frames(*(tmp_path / place for place in reversed(places)))
    assert (frames.path, frames.names) == (tmp_path, tuple(places))
    for (_, image), picture in zip(frames, pictures, strict=False):
        np.testing.assert_allclose(image, picture, atol=1e-9)
    assert open_frames(tmp_path / "a/2.png").names == ("2.png",)
    with pytest.raises(ValueError, match=r"none\.png"):
        open_frames(tmp_path / "a/2.png", tmp_path / "none.png")


def write_numbered(path, code, count=30, rate=25.0):
    """A video whose frames count themselves: a bright bar, 8 px longer in each."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), rate, (320, 64))
    assert writer.isOpened()
    for number in range(count):
        shot = np.full((64, 320, 3), 20, np.uint8)
        shot[:16, : 8 * number] = 220
        writer.write(shot)
    writer.release()
    return path.read_bytes()


def number_of(image):
    """The number that a frame counts; the bar is at the top left, unless the picture was turned."""
    return round(float((image[4:12].mean(axis=(0, 2)) > 0.5).sum()) / 8)


def numbers_in(path):
    return [
        None if image is None else number_of(image) for _, image in open_frames(path)
    ]


def at_another_rate(content):
    """A Matroska file whose header says 10 frames/s, whatever its frames are timed at."""
    place = content.index(b"\x23\xe3\x83\x84") + 4
    return content[:place] + struct.pack(">I", 100_000_000) + content[place + 4 :]


def with_length(count):
    """An AVI file whose header says it has so many frames."""

    def change(content):
        place = content.index(b"strh") + 40
        return content[:place] + struct.pack("<I", count) + content[place + 4 :]

    return change


def twice(content):
    return content + content


@pytest.mark.parametrize(
    ("name", "code", "rate", "change", "count"),
    [
        ("v.mpg", "MPG2", 30.0, twice, 60),
        ("v.ts", "MPG2", 25.0, twice, 60),
        ("v.flv", "FLV1", 25.0, bytes, 30),
        ("v.mkv", "mp4v", 30.0, at_another_rate, 30),
        ("v.mkv", "VP80", 1000.0, bytes, 30),
        ("v.avi", "MJPG", 25.0, with_length(7), 30),
        ("v.avi", "MJPG", 25.0, with_length(500), 30),
    ],
)
def test_the_frames_of_a_video_are_those_that_can_be_decoded(
    tmp_path, name, code, rate, change, count
):
    """Whatever its header estimates: none is lost, and none promised that never was."""
    content = write_numbered(tmp_path / name, code, rate=rate)
    (tmp_path / name).write_bytes(change(content))
    assert numbers_in(tmp_path / name) == [*range(30)] * (count // 30)


@pytest.mark.parametrize("matrix", [(0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0)])
def test_a_video_marked_as_turned_is_read_as_the_sensor_saw_it(
    tmp_path, caplog, matrix
):
    path = tmp_path / "v.mp4"
    content = bytearray(write_numbered(path, "mp4v"))
    a, b, c, d = (65536 * number for number in matrix)
    struct.pack_into(">6i", content, content.index(b"tkhd") + 44, a, b, 0, c, d, 0)
    path.write_bytes(content)
    assert numbers_in(path) == [*range(30)]
    assert number_of(dict(open_stream(path))["000007"]) == 7
    assert caplog.text.count("v.mp4 is marked to be shown turned") == 2


def test_what_is_damaged_in_the_middle_of_a_video_shifts_no_names(tmp_path):
    content = bytearray(write_numbered(tmp_path / "v.mov", "MJPG"))
    starts = [
        place
        for place in range(len(content))
        if content[place : place + 3] == b"\xff\xd8\xff"
    ]
    assert len(starts) == 30
    content[starts[9] : starts[11]] = bytes(starts[11] - starts[9])
    (tmp_path / "v.mov").write_bytes(content)
    expected = [*range(9), None, None, *range(11, 30)]
    assert numbers_in(tmp_path / "v.mov") == expected
    ((_, image),) = open_frames(tmp_path / "v.mov").read(["000011"])
    assert number_of(image) == 11
    played = {name: number_of(image) for name, image in open_stream(tmp_path / "v.mov")}
    assert played == {
        f"{number:06d}": number for number in expected if number is not None
    }


def test_a_video_that_ends_early_says_so(video, caplog):
    content = video.read_bytes()
    assert len(open_frames(video)) == 12
    assert caplog.text == ""
    video.write_bytes(content[: len(content) // 2])
    count = len(open_frames(video))
    assert 0 < count < 12
    assert all(image is not None for _, image in open_frames(video))
    assert (
        f"v.mkv: ends after {count} frames, where its header tells of 12" in caplog.text
    )


def test_a_video_that_is_interlaced_is_refused(tmp_path, caplog, pictures):
    """For OpenCV gives what lay in memory for each frame, without an error; stills are no such videos."""
    content = bytearray(write_numbered(tmp_path / "v.mpg", "MPG2"))
    assert len(open_frames(tmp_path / "v.mpg")) == 30
    write_video(tmp_path / "still.mkv", pictures[:1] * 3)
    assert len(open_frames(tmp_path / "still.mkv")) == 3
    assert caplog.text == ""
    for place in range(len(content) - 8):
        if content[place : place + 4] == b"\0\0\1\xb5":
            if content[place + 4] >> 4 == 1:  # the sequence
                content[place + 5] &= 0xF7
            elif content[place + 4] >> 4 == 8:  # a picture
                content[place + 8] &= 0x7F
    (tmp_path / "i.mpg").write_bytes(content)
    for read in (open_frames, open_stream):
        with pytest.raises(ValueError, match=r"i\.mpg.*interlaced"):
            read(tmp_path / "i.mpg")


@pytest.mark.parametrize("name", ["v.MTS", "video_0001", "v.mjpeg"])
def test_a_video_is_known_by_what_it_is_whatever_its_name(tmp_path, name):
    content = write_numbered(tmp_path / "v.avi", "MJPG")
    place = content.index(
        b"\xff\xd8\xff"
    )  # a raw stream is pictures, one after the other
    (tmp_path / name).write_bytes(content[place:] if name == "v.mjpeg" else content)
    assert is_sequence(tmp_path / name)
    assert len(open_frames(tmp_path / name)) == 30


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp"])
def test_a_picture_is_known_by_what_it_is_where_its_name_does_not_tell(
    tmp_path, suffix
):
    path = tmp_path / "IMG0001"
    path.write_bytes(
        cv2.imencode(suffix, np.full((8, 8, 3), 255, np.uint8))[1].tobytes()
    )
    assert not is_sequence(path)
    assert open_frames(path).names == ("IMG0001",)
    np.testing.assert_allclose(dict(open_frames(path))["IMG0001"], 1, atol=1e-9)


SECRETS = [
    "rtsp://user:secret@127.0.0.1:9/live",
    "RTSP://secret@127.0.0.1:9/live",
    "http://user:sec@secret/x@127.0.0.1:9/live",
    "http://127.0.0.1:9/live?user=a&pwd=secret",
    "rtmp://127.0.0.1:9/app/secret",
]


@pytest.mark.parametrize("url", SECRETS)
@pytest.mark.parametrize("read", [open_stream, open_frames, read_image, write_video])
def test_what_is_secret_in_a_url_is_in_no_message(url, read):
    for source in (url, Path(url)):
        with pytest.raises((ValueError, OSError)) as caught:
            read(source) if read is not write_video else read(source, [])
        assert "secret" not in str(caught.value)


@pytest.mark.parametrize("url", SECRETS[::2])
@pytest.mark.parametrize(
    "command",
    [
        "reconstruct {} --calibration simple --out r",
        "calibrate {} --target charuco --out c.json",
        "evaluate {} {}",
    ],
)
def test_no_command_says_what_is_secret_in_a_url(
    url, command, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    assert main(command.replace("{}", url).split()) == 2
    output = capfd.readouterr()
    assert "endolab: " in output.err
    assert "secret" not in output.out + output.err
    assert not list(tmp_path.rglob("*secret*"))


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
    assert is_sequence("none.MJPEG")
    assert not is_sequence("none.MP4")  # nothing is there
    assert not is_sequence("a.png")
    assert is_stream(0)
    assert is_stream("0")
    assert is_stream("http://127.0.0.1/x")
    assert not is_stream("0.png")
    Path("0").mkdir()
    assert not is_stream("0")


def test_a_video_larger_than_memory_is_refused_before_a_frame_is_decoded(
    video, monkeypatch
):
    monkeypatch.setattr(
        "psutil.virtual_memory", lambda: type("Memory", (), {"available": 10_000})
    )
    with pytest.raises(MemoryError, match=r"v\.mkv: a frame of 32x24 px"):
        open_frames(video)


def test_a_video_is_played_at_its_own_rate_and_can_be_ended(video, pictures):
    stream = open_stream(video)
    assert stream.rate == pytest.approx(40)
    started = time.perf_counter()
    at = []
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
