"""``warp-plate render``: every kind of file, and invalid options."""

import json
import os
import signal
import subprocess

import numpy as np
import pytest

from support.commands import error_of, output_of
from warp_plate.analysis.motion import frame_at, motions
from warp_plate.cli.render import FrameOptions, frames_around
from warp_plate.result.model import load_result
from warp_plate.viz import availability

pytest.importorskip("pyvista", reason="PyVista is not installed: pip install 'warp-plate[viz]'")


@pytest.fixture
def render(result_file, tmp_path, monkeypatch, command):
    """Run the command in an empty folder; return (status, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)

    def run(*options):
        width = [] if "--width" in options else ["--width", "160"]
        return command("render", result_file, "--device", "cpu", *width, *options)

    return run


def files_of(answer):
    return json.loads(output_of(answer))["files"]


def frames_of(path):
    from PIL import Image

    with Image.open(path) as movie:
        for index in range(movie.n_frames):
            movie.seek(index)
            yield np.asarray(movie.convert("RGB")).astype(int)


def test_the_default_is_a_picture(render, drawing, tmp_path):
    assert files_of(render("--json")) == ["run.png"]
    (picture,) = frames_of(tmp_path / "run.png")
    assert ((picture.max(axis=-1) - picture.min(axis=-1)) > 100).sum() > 300
    assert [path.name for path in tmp_path.iterdir()] == ["run.png"]


def test_movies_play_all_frames(render, drawing, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")

    options = "--out a.gif --out a.mp4 --frames 6 --rate 12 --case best --json"
    assert files_of(render(*options.split())) == ["a.gif", "a.mp4"]
    frames = np.array(list(frames_of(tmp_path / "a.gif")))
    assert len(frames) == 6
    assert (np.diff(frames, axis=0) != 0).any(axis=(1, 2, 3)).all()
    assert (frames[:, 0] == 255).all()
    height, width = (side // 2 * 2 for side in frames.shape[1:3])
    words = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", "a.mp4", "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    read = subprocess.run(words, capture_output=True, check=True)
    assert all(part in read.stderr.decode() for part in ("Video: h264", "yuv420p", f"{width}x{height}", "12 fps"))
    played = np.frombuffer(read.stdout, np.uint8).reshape(-1, height, width, 3).astype(int)
    assert len(played) == 72  # repeated to last six seconds
    assert np.abs(played[6] - frames[0][:height, :width]).mean() < 4
    assert np.abs(played[0] - played[3]).mean() > np.abs(played[0] - played[6]).mean()


def test_a_movie_that_is_cut_short_is_not_kept(render, drawing, tmp_path):
    resource = pytest.importorskip("resource", reason="Windows has no limit on the size of files")
    options = ["--out", "a.mp4", "--frames", "6", "--rate", "12", "--case", "best"]
    output_of(render(*options))
    movie, before = (tmp_path / "a.mp4").read_bytes(), resource.getrlimit(resource.RLIMIT_FSIZE)
    for share in (0.2, 0.95):  # as on a full disk
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(share * len(movie)), before[1]))
        try:
            refused = render(*options)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert "a.mp4: cannot be written: its encoder ended with status" in error_of(refused)
        assert (tmp_path / "a.mp4").read_bytes() == movie
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_pages_and_plans_need_no_window(render, monkeypatch, tmp_path):
    """A browser or Matplotlib draws them, without VTK's windows."""
    (tmp_path / "vtkmodules.py").write_text("raise SystemExit(1)", encoding="utf-8")  # of trial drawings
    monkeypatch.syspath_prepend(tmp_path)
    availability.working_window.cache_clear()
    try:
        few = ("--case", "best", "--frames", "6")
        output_of(render("--out", "a.html", "--out", "a.svg", "--out", "a.pdf", "--field", "phase", *few))
        output_of(render("--out", "b.png", "--plan", "--time", "0.0095", *few))
        output_of(render("--modes", "2", "--frames", "6", "--out", "modes.html"))
        assert "the plate cannot be drawn" in error_of(render("--out", "c.png"))
    finally:
        availability.working_window.cache_clear()
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    assert "phase lag" in (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "displacement\\nover its largest" in (tmp_path / "modes.html").read_text(encoding="utf-8")
    assert "<svg" in (tmp_path / "a.svg").read_text(encoding="utf-8")
    (picture,) = frames_of(tmp_path / "b.png")
    assert ((picture.max(axis=-1) - picture.min(axis=-1)) > 100).sum() > 1000
    assert not list(tmp_path.glob(".*"))


def test_invalid_options_are_named(render, tmp_path):
    for options, complaint in (
        ("--out a.jpg", "--out a.jpg: must end in .png, .svg, .pdf, .gif, .mp4 or .html"),
        ("--out no/a.png", "--out no/a.png: no such folder: no"),
        ("--width 10", "Must be >= 120."),
        ("--rate 1000", "--rate 1000: must be from 1 to 120"),
        ("--heights 0", "--heights 0: must be above 0"),
        ("--colormap jett", "colormap = 'jett': must be a colour map of Matplotlib, such as viridis"),
        ("--limits own", "limits = 'own': must be common, each, or a number above 0"),
        ("--limits 0", "limits = 0: must be common, each, or a number above 0"),
        ("--limits 3 --field phase", "limits = 3: phase lag has limits of its own; leave them out"),
        ("--case worst", "--case 'worst': must be one of"),
        ("--frames 1", "Must be >= 2."),
        ("--modes 40", "Must be <= 6."),
        ("--modes 2 --field phase", "--field phase: mode shapes have displacements only"),
        ("--time 7", "--time 7: must be from 0 to 0.012 s"),
        ("--time 0.001 --start 0.01", "--time 0.001: must lie between start and end, 0.01 and 0.012 s"),
        ("--start 0.01 --end 7", "--start 0.01, --end 7: must lie within the run"),
    ):
        out = [] if "--out" in options else ["--out", "a.html"]
        assert complaint in error_of(render(*options.split(), *out))
        assert not list(tmp_path.iterdir())


def test_a_moment_is_the_frame_of_pictures(result_file):
    """--time selects a frame of the period from there on, or of the last one."""
    result = load_result(result_file)
    period = 1 / result.scene.drive.frequency
    for time, start, span in (
        (0.004, None, (0.004, 0.004 + period)), (0.0119, None, (0.012 - period, 0.012)), (None, 0.001, (0.001, None))
    ):  # fmt: skip
        around = frames_around(result, time, FrameOptions(start=start))
        assert (around.start, around.end) == pytest.approx(span)
    shown = motions(result.scene, result.cases, (0.012 - period, 0.012), device="cpu")
    moment = shown[0].times[frame_at(shown[0], 0.0119)]
    assert moment == pytest.approx(0.0119, abs=period / 20)


def test_ctrl_c_keeps_the_files_that_are_done(render, monkeypatch, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", interrupted)
    for out, line in (("a.html", "interrupted; wrote only a.html"), ("a.svg", "interrupted")):
        assert render("--out", out, "--out", "b.svg") == (130, "", f"warp-plate: {line}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]


@pytest.mark.parametrize("out", ["a.png", "a.gif"])
def test_ctrl_c_in_a_filter_of_vtk_is_not_lost(out, render, drawing, monkeypatch, tmp_path):
    """VTK reports exceptions of filters written in Python, and draws on without them."""
    from vtkmodules.util.vtkAlgorithm import VTKPythonAlgorithmBase

    def interrupted(*given, request=VTKPythonAlgorithmBase.ProcessRequest):
        os.kill(os.getpid(), signal.SIGTERM)
        return request(*given)

    monkeypatch.setattr(VTKPythonAlgorithmBase, "ProcessRequest", interrupted)
    assert render("--out", out, "--frames", "4") == (130, "", "warp-plate: interrupted\n")
    assert not list(tmp_path.iterdir())


def test_ctrl_c_that_ends_the_encoder_of_a_movie(render, drawing, monkeypatch, tmp_path):
    """A terminal sends it to all processes of a command."""
    pytest.importorskip("imageio_ffmpeg")

    def interrupted(*given, start=subprocess.Popen, **options):
        encoder = start(*given, **options)
        if options.keys() == {"stdin"}:
            os.kill(os.getpid(), signal.SIGTERM)
            encoder.kill()
        return encoder

    monkeypatch.setattr("subprocess.Popen", interrupted)
    assert render("--out", "a.mp4", "--frames", "4") == (130, "", "warp-plate: interrupted\n")
    assert not list(tmp_path.iterdir())
