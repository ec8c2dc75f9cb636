"""Meshes: whole where the surface is, torn where it is torn, written as they are, measured rightly."""

import builtins
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib import colormaps

from endolab.datasets import load_calibration
from endolab.depth.result import Iterate
from endolab.io.surfaces import write_mesh
from endolab.metrics.depth_errors import occlusion_cuts
from endolab.metrics.mesh_distance import distance_to, to_open3d
from endolab.numerics.threads import limited_threads
from endolab.plots import surface_view as mesh_views
from endolab.reconstruction.mesh import make_mesh
from endolab.synthetic.scenes import SCENES, Bowl, Plane, Tube
from endolab.uncertainty.trust import trust_of
from tests.tools.problems import coloured_colon

CAMERA = load_calibration("paper", 160).camera
RAYS = CAMERA.field.rays


def points_of(scene):
    return scene.distance(RAYS)[..., None] * RAYS


def facing(mesh):
    """Cross product of two sides of each triangle, and its first corner."""
    corners = mesh.vertices[mesh.triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]


def wall(rows=5, columns=7):
    x, y = np.meshgrid(np.arange(columns) - 3.0, np.arange(rows) - 2.0)
    return np.stack([x, y, np.full_like(x, 50.0)], axis=-1)


@pytest.fixture(scope="module")
def colon():
    return coloured_colon(CAMERA)[1]


@pytest.fixture(scope="module")
def coloured(colon):
    return make_mesh(points_of(SCENES["colon"]), colon.image, cuts=occlusion_cuts(colon.distance))


def test_a_full_grid_has_two_triangles_a_square():
    mesh = make_mesh(wall(5, 7))
    assert mesh.vertices.shape == mesh.colours.shape == mesh.normals.shape == (35, 3)
    assert mesh.triangles.shape == (2 * 4 * 6, 3)
    assert np.linalg.norm(facing(mesh)[0], axis=-1).sum() / 2 == pytest.approx(24.0)
    assert np.allclose(mesh.normals, [0, 0, -1])
    assert mesh.unit == "mm"


@pytest.mark.parametrize("place", [(2, 3), (0, 0), (0, 3), (4, 6)])
def test_a_hole_takes_its_pixel_and_no_more(place):
    """Each square around it keeps the triangle of its other three corners."""
    points = wall(5, 7)
    points[place] = np.nan
    mesh = make_mesh(points)
    around = np.prod([2 if 0 < i < n - 1 else 1 for i, n in zip(place, (5, 7), strict=True)])
    assert len(mesh.vertices) == 34
    assert len(mesh.triangles) == 48 - around
    assert np.isfinite(mesh.vertices).all()
    assert np.allclose(mesh.normals, [0, 0, -1])


def test_a_line_of_pixels_or_none_is_no_surface():
    points = np.full((4, 4, 3), np.nan)
    for row in (np.nan, wall(1, 4)[0]):
        points[2] = row
        mesh = make_mesh(points)
        assert mesh.vertices.shape == mesh.triangles.shape == (0, 3)


def test_no_triangle_crosses_a_cut():
    points, cuts = wall(6, 8), np.zeros((2, 6, 8), dtype=bool)
    cuts[0, :, 3] = True  # columns 3 and 4 are torn apart
    cuts[1, 2, :4] = True  # and rows 2 and 3 on the left
    mesh = make_mesh(points, cuts=cuts)
    left, upper = np.moveaxis(mesh.vertices[mesh.triangles][..., :2] < 0.5, -1, 0)
    at_left = left.all(axis=1)
    assert (at_left | ~left.any(axis=1)).all()
    assert (upper[at_left].all(axis=1) | ~upper[at_left].any(axis=1)).all()
    assert len(mesh.triangles) == 2 * (3 * 5 + 3 * 2 * 2)
    assert len(mesh.vertices) == 48


def test_a_result_brings_colours_cuts_and_unit():
    problem, colon = coloured_colon(CAMERA)
    cuts = occlusion_cuts(colon.distance)
    problem = replace(problem, cuts=cuts, metric=False)
    iterate = Iterate.of(problem, np.log(colon.distance))
    mesh = make_mesh(iterate)
    assert mesh.unit == "relative units"
    again = make_mesh(np.where(problem.mask[..., None], iterate.points, np.nan), colon.image, cuts=cuts)
    assert np.array_equal(mesh.triangles, again.triangles)
    assert np.array_equal(mesh.colours, again.colours)
    grey = make_mesh(replace(iterate, problem=replace(problem, picture=None)))
    assert np.array_equal(grey.colours[:, 0], grey.colours[:, 2])


def test_colours_stay_with_their_pixels(coloured, colon):
    u, v = np.round(CAMERA.project(coloured.vertices)).astype(int).T
    assert np.allclose(coloured.colours, colon.image[v, u].clip(0, 1))
    grey = make_mesh(wall(), np.linspace(0, 1, 35).reshape(5, 7))
    assert np.allclose(grey.colours, np.linspace(0, 1, 35)[:, None])


@pytest.mark.parametrize("name", SCENES)
def test_normals_face_the_camera_and_are_the_scenes(name):
    scene = SCENES[name]
    mesh = make_mesh(points_of(scene), cuts=occlusion_cuts(scene.distance(RAYS)))
    assert (np.einsum("ni,ni->n", *facing(mesh)) < 0).all()
    assert (np.einsum("ni,ni->n", mesh.normals, mesh.vertices) < 0).all()
    assert np.allclose(np.linalg.norm(mesh.normals, axis=-1), 1)
    cosine = np.einsum("ni,ni->n", mesh.normals, scene.normals(mesh.vertices)).clip(-1, 1)
    assert np.rad2deg(np.median(np.arccos(cosine))) < 1.0


def test_occlusions_are_torn_by_the_rule_too_and_walls_are_not():
    """With no cuts given, few triangles float between two surfaces; a tube has no tear."""
    scene = SCENES["colon"]
    points = points_of(scene)

    def floating(mesh):
        middle = mesh.vertices[mesh.triangles].mean(axis=1)
        before_the_end = middle[:, 2] < scene.length - 1
        return np.mean(before_the_end & (np.abs(scene._inside(*(middle + scene._camera).T)[0]) > 1.0))

    joined = floating(make_mesh(points, jump=np.inf))
    assert joined > 0.02
    assert floating(make_mesh(points)) < joined / 4
    tube = points_of(SCENES["tube"])
    assert len(make_mesh(tube).triangles) == len(make_mesh(tube, jump=np.inf).triangles)


def test_a_step_needs_both_a_jump_and_a_grazing_view_to_be_torn():
    points = wall(4, 6)
    points[:, 3:] *= 1.5
    assert len(make_mesh(points).triangles) == 2 * 3 * 4
    assert len(make_mesh(points, jump=1.6).triangles) == 2 * 3 * 5
    assert len(make_mesh(points, grazing=89.9).triangles) == 2 * 3 * 5
    assert len(make_mesh(points, jump=1.0, grazing=0.0).triangles) < 2 * 3 * 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shown": np.zeros((4, 3))}, r"\(H, W, 3\), found \(4, 3\)"),
        ({"colours": np.zeros((2, 2))}, "colours must have shape"),
        ({"cuts": np.zeros((5, 7), dtype=bool)}, "cuts must be a bool array"),
        ({"cuts": np.zeros((2, 5, 7))}, "found float64"),
        ({"jump": 0.9}, "jump must be at least 1"),
        ({"grazing": 91.0}, "grazing from 0 to 90"),
    ],
)
def test_what_does_not_fit_is_said(options, message):
    with pytest.raises(ValueError, match=message):
        make_mesh(**{"shown": wall()} | options)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".PLY"])
def test_open3d_reads_what_was_written(coloured, tmp_path, open3d, suffix):
    path = tmp_path / f"mesh{suffix}"
    write_mesh(path, coloured)
    read = open3d.io.read_triangle_mesh(str(path))
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert len(read.vertices) == len(coloured.vertices)
    ours, theirs = coloured.triangles, np.asarray(read.triangles)  # vertices may come in another order
    for values, wanted, tolerance in (
        (read.vertices, coloured.vertices, 1e-3),
        (read.vertex_normals, coloured.normals, 1e-4),
        (read.vertex_colors, coloured.colours, 0.5 / 255 + 1e-6),
    ):
        assert np.abs(np.asarray(values)[theirs] - wanted[ours]).max() < tolerance


def test_a_file_tells_its_unit_and_frame(tmp_path):
    mesh = replace(make_mesh(wall()), unit="relative units")
    for name in ("a.ply", "a.obj"):
        write_mesh(tmp_path / name, mesh)
        head = (tmp_path / name).read_bytes()[:200]
        assert b"unit: relative units" in head
        assert b"y down" in head


@pytest.fixture(scope="module")
def trusted():
    """A colon's surface, and how far it can be trusted."""
    problem, colon = coloured_colon(CAMERA.resize(80, 60))
    iterate = Iterate.of(problem, np.log(colon.distance))
    with limited_threads(1):  # Numba warns of the TBB that Open3D has loaded when it first takes several
        return iterate, trust_of(iterate, draws=4)


def test_colours_of_trust_grow_brighter_with_sigma(trusted):
    iterate, trust = trusted
    mesh, plain = make_mesh(iterate, trust=trust), make_mesh(iterate)
    assert np.array_equal(mesh.vertices, plain.vertices)
    u, v = np.round(iterate.problem.camera.project(mesh.vertices)).astype(int).T
    percent = (100 * trust.sigma / iterate.distance)[v, u]
    most = float(re.fullmatch(r".* bright ([\d.]+) % of it, or more \(magma\)", mesh.legend)[1])
    assert most == pytest.approx(np.nanpercentile(100 * trust.sigma / iterate.distance, 98), rel=0.05)
    assert percent.max() > 1.2 * percent.min()
    scale = np.asarray(colormaps["magma"](np.clip(percent / most, 0, 1)))[:, :3]
    assert np.abs(mesh.colours - scale).max() < 0.02


def test_a_file_tells_what_colours_of_trust_mean(trusted, tmp_path):
    iterate, trust = trusted
    mesh = make_mesh(iterate, trust=trust)
    for name, begin in (("a.ply", "comment"), ("a.obj", "#")):
        write_mesh(tmp_path / name, mesh)
        assert f"\n{begin} colours: {mesh.legend}\n".encode() in (tmp_path / name).read_bytes()[:400]
        write_mesh(tmp_path / name, make_mesh(iterate))
        assert b"colours" not in (tmp_path / name).read_bytes()[:400]


def test_trust_of_something_else_is_refused(trusted):
    iterate, trust = trusted
    with pytest.raises(ValueError, match="mere points have none"):
        make_mesh(iterate.points, trust=trust)
    with pytest.raises(ValueError, match="not both"):
        make_mesh(iterate, iterate.problem.shown, trust=trust)
    with pytest.raises(ValueError, match=r"trust has shape \(2, 2\), the result \(60, 80\)"):
        make_mesh(iterate, trust=replace(trust, sigma=np.ones((2, 2))))


def test_an_unknown_kind_of_file_leaves_nothing(tmp_path):
    for name, found in (("mesh.stl", ".stl"), ("mesh", "no suffix")):
        with pytest.raises(ValueError, match=f"written as .ply or .obj, found {found}"):
            write_mesh(tmp_path / name, make_mesh(wall()))
    with pytest.raises(OSError, match="cannot write"):
        write_mesh(tmp_path / "nowhere" / "mesh.ply", make_mesh(wall()))
    assert list(tmp_path.iterdir()) == []


def test_open3d_takes_it_over(coloured, open3d):
    made = to_open3d(coloured)
    assert isinstance(made, open3d.geometry.TriangleMesh)
    assert made.has_vertex_colors()
    assert made.has_vertex_normals()
    assert np.array_equal(np.asarray(made.vertices), coloured.vertices)


@pytest.mark.parametrize(
    ("scene", "off"),
    [
        (Plane(60.0, 20.0), lambda p: (p - [0, 0, 60.0]) @ Plane(60.0, 20.0)._normal),
        (Bowl(), lambda p: 115.0 - np.linalg.norm(p - np.array(Bowl().centre), axis=-1)),
        (Tube(18.5, 400.0), lambda p: 18.5 - np.linalg.norm(p[:, :2], axis=-1)),
    ],
    ids=["plane", "ball", "tube"],
)
def test_distances_are_those_of_the_analytic_surface(scene, off, open3d):
    """Of a surface that is too near by a few per cent, to 0.01 mm."""
    distance = scene.distance(RAYS)
    distance = np.where(distance < 150, distance * np.linspace(0.95, 1.0, 160), np.nan)
    mesh = make_mesh(distance[..., None] * RAYS)
    found = distance_to(mesh, scene.mesh())
    expected = np.abs(off(mesh.vertices))
    assert np.abs(found.distance - expected).max() < 0.01
    told, true = (found.mean, found.median, found.percentile_95), np.percentile(expected, [50, 95])
    assert told == pytest.approx((expected.mean(), *true), abs=0.01)
    assert expected.max() > 0.5
    same = distance_to(mesh, make_mesh(points_of(scene)))  # a mesh from a grid is coarser
    assert same.mean == pytest.approx(expected.mean(), abs=0.1)


def test_mere_points_are_enough():
    points = wall()
    truth = points + np.array([0, 0, 2.0])
    truth[0, 0] = np.nan
    found = distance_to(make_mesh(points), truth)
    assert np.allclose(found.distance[1:], 2.0)
    assert found.distance[0] == pytest.approx(np.sqrt(5))


def test_a_mesh_without_a_scale_needs_one(open3d):
    mesh = replace(make_mesh(wall() / 10), unit="relative units")
    with pytest.raises(ValueError, match="relative units: give scale"):
        distance_to(mesh, make_mesh(wall()))
    assert distance_to(mesh, make_mesh(wall()), scale=10.0).mean == pytest.approx(0, abs=1e-4)
    with pytest.raises(ValueError, match="nothing to measure: the mesh has 35 vertices, the truth 0"):
        distance_to(mesh, np.full((3, 3), np.nan), scale=10.0)


def test_without_open3d_meshes_are_made_and_written_and_the_rest_says_why(monkeypatch, tmp_path):
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    really = builtins.__import__

    def refuse(name, *rest):
        if name.split(".")[0] == "open3d":
            raise ImportError("libusb-1.0.so.0: cannot open shared object file")
        return really(name, *rest)

    monkeypatch.setattr(builtins, "__import__", refuse)
    mesh = make_mesh(wall())
    for name in ("mesh.ply", "mesh.obj"):
        write_mesh(tmp_path / name, mesh)
    for call in (to_open3d, mesh_views.show_mesh, lambda m: distance_to(m, m)):
        with pytest.raises(OSError, match=r"Open3D does not import .*libusb"):
            call(mesh)


def test_without_a_screen_there_is_a_picture_and_a_sentence(coloured, monkeypatch, capsys, open3d):
    monkeypatch.setattr(mesh_views, "_show_window", lambda *_: False)
    ax = mesh_views.show_mesh(coloured, angle=50)
    assert "No window can open here" in capsys.readouterr().out
    picture = ax.images[0].get_array()
    assert ax.artists[0].txt_label.get_text().endswith(" mm")
    ax.figure.canvas.draw()
    assert picture.std() > 0.1
    again = mesh_views.show_mesh(coloured, plt.subplots()[1])
    assert capsys.readouterr().out == ""
    assert not np.array_equal(again.images[0].get_array(), picture)
    mesh_views.show_mesh(make_mesh(np.full((3, 3, 3), np.nan)), again).figure.canvas.draw()
    plt.close("all")


def test_a_wall_is_seen_where_it_is(open3d):
    """A square of 20 mm at 50 mm, from 30° to the left: 17.3 mm wide, 25 mm to the left."""
    x, y = np.meshgrid(np.linspace(-10, 10, 30), np.linspace(-10, 10, 30))
    mesh = make_mesh(np.stack([x, y, np.full_like(x, 50.0)], axis=-1))
    picture, (left, right, bottom, top) = mesh_views.render_side(mesh, angle=30, elevation=0, width=400)
    assert bottom > top  # y points down
    rows, columns = np.nonzero(picture.any(axis=-1))
    pixel = (right - left) / 400
    assert (np.ptp(columns) + 1) * pixel == pytest.approx(20 * np.cos(np.deg2rad(30)), abs=2 * pixel)
    assert (np.ptp(rows) + 1) * pixel == pytest.approx(20, abs=2 * pixel)
    assert left + (columns.mean() + 0.5) * pixel == pytest.approx(-25, abs=pixel)
    assert top + (rows.mean() + 0.5) * pixel == pytest.approx(0, abs=pixel)
    assert not mesh_views.render_side(mesh, angle=150, elevation=0, width=100)[0].any()  # its back


@pytest.mark.parametrize("opens", [True, False])
def test_a_window_opens_where_there_is_a_screen(coloured, monkeypatch, open3d, opens):
    shown = []

    window = SimpleNamespace(
        create_window=lambda **how: opens,
        add_geometry=lambda mesh: shown.append(len(mesh.triangles)),
        get_view_control=lambda: SimpleNamespace(set_front=print, set_up=print),
        run=lambda: shown.append("run"),
        destroy_window=lambda: shown.append("closed"),
    )
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(open3d.visualization, "Visualizer", lambda: window)
    ax = mesh_views.show_mesh(coloured)
    assert (ax is None) == opens
    assert shown == ([len(coloured.triangles), "run", "closed"] if opens else [])
    plt.close("all")
