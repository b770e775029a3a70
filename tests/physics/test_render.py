"""Pictures by rasterising: camera, visibility, light, shadows and textures against closed forms."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from nuno_render.config import Legend, RasterConfig
from nuno_render.raster import Raster, radiance, rasterise, sample_offsets
from nuno_render.shading.lighting import GROUND, KEY, SKY
from nuno_schemas.colour import colours, parse_hex, to_linear, to_srgb
from nuno_schemas.errors import BadInput
from nuno_schemas.pictures import Camera, Mesh, axes, frame


def project(camera, points):
    """(n, 2) picture coordinates, -1 to 1 on both axes."""
    right, up, forward = axes(camera)
    relative = points - camera.eye
    depth = relative @ forward
    assert (depth > 0).all()
    slope = math.tan(camera.fov / 2)
    aspect = camera.size[0] / camera.size[1]
    return np.column_stack([relative @ right / depth / slope / aspect, relative @ up / depth / slope])


@pytest.mark.parametrize("azimuth", [0.0, 0.9, 4.0])
@pytest.mark.parametrize("elevation", [-0.3, 0.4, math.pi / 2])
@pytest.mark.parametrize("size", [(960, 720), (200, 700)])
def test_points_fill_the_picture_up_to_the_margin(azimuth, elevation, size):
    points = np.random.default_rng(3).normal(size=(300, 3)) * [1.0, 2.0, 0.5] + [10.0, -5.0, 2.0]
    camera = frame(points, azimuth, elevation, size, fov=0.6, margin=0.1)
    place = project(camera, points)
    assert np.abs(place).max() < 0.8 + 1e-9
    # Some axis touches its margin on both sides: nothing larger would fit.
    touches = (place.max(axis=0) > 0.8 - 1e-9) & (place.min(axis=0) < -0.8 + 1e-9)
    assert touches.any()


def test_axes_are_a_right_handed_frame():
    camera = frame(np.eye(3), 0.7, 0.3)
    right, up, forward = axes(camera)
    assert np.allclose(np.array([right, up, -forward]) @ np.array([right, up, -forward]).T, np.eye(3), atol=1e-14)
    assert np.allclose(np.cross(right, up), -forward, atol=1e-14)


def test_azimuth_zero_looks_along_y_and_turns_counter_clockwise():
    points = np.array([[-1.0, -1, -1], [1, 1, 1]])
    assert np.allclose(axes(frame(points, 0.0, 0.0))[2], [0, 1, 0])
    assert np.allclose(axes(frame(points, math.pi / 2, 0.0))[2], [-1, 0, 0])


def test_points_that_are_not_finite_do_not_count():
    points = np.random.default_rng(0).normal(size=(20, 3))
    broken = np.vstack([points, [[np.nan, 0, 0], [np.inf, 0, 0]]])
    assert np.array_equal(frame(points).eye, frame(broken).eye)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((1, 3)), np.full((4, 3), np.nan)])
def test_no_extent_still_gives_a_camera(points):
    camera = frame(points)
    assert np.isfinite(camera.eye).all()
    assert np.linalg.norm(camera.eye - camera.target) > 0


@pytest.mark.parametrize("bad", [{"fov": 0.0}, {"fov": math.nan}, {"margin": 0.5}, {"size": (0, 10)}])
def test_bad_arguments_are_refused(bad):
    with pytest.raises(BadInput, match="camera"):
        frame(np.eye(3), **bad)


def test_camera_without_direction_is_refused():
    for eye, up in ((np.zeros(3), [0.0, 0, 1]), (np.array([0, 0, 1.0]), [0.0, 0, 1])):
        with pytest.raises(BadInput, match="camera"):
            axes(Camera(eye, np.zeros(3), np.array(up), 0.5, (10, 10)))


def test_srgb_transfer_is_inverted_and_meets_its_standard_values():
    value = np.linspace(0, 1, 1001)
    assert np.abs(to_srgb(to_linear(value)) - value).max() < 1e-6
    assert abs(to_linear(0.5) - 0.21404114) < 1e-7
    assert np.allclose(parse_hex("#ff8000"), [1.0, 0.21586, 0.0], atol=1e-5)


def test_equal_steps_of_value_are_equal_steps_of_lightness():
    # CIE 1976 lightness of the map's luminance: a straight line, to within 2 of 100.
    value = np.linspace(0, 1, 101)
    luminance = colours(value, 0.0, 1.0) @ [0.2126, 0.7152, 0.0722]
    lightness = np.where(luminance > 0.008856, 116 * np.cbrt(luminance) - 16, 903.3 * luminance)
    assert (np.diff(lightness) < 0).all()
    line = lightness[0] + value * (lightness[-1] - lightness[0])
    assert np.abs(lightness - line).max() < 2.0


def test_limits_missing_values_and_empty_ranges():
    low, high, missing = parse_hex("#f6f1e6"), parse_hex("#a50026"), parse_hex("#9a9a9a")
    assert np.allclose(colours([-5.0, 2.0, np.nan, 9.0], 2.0, 3.0), [low, low, missing, high])
    assert np.allclose(colours([1.0, 2.0], 1.0, 1.0), [low, low])


SIZE = 64


def draw(clip, faces, samples=1, order=None, near=1e-3, two_sided=True):
    """Covered samples, and the owner (SIZE, SIZE, samples) of each."""
    faces = np.asarray(faces, np.int32).reshape(-1, 3)
    depth = np.zeros((SIZE, SIZE, samples), np.float32)
    owner = np.full(depth.shape, -1, np.int32)
    mesh, sides = np.zeros(len(faces), np.int32), np.array([two_sided])
    covered = rasterise(np.asarray(clip, float), faces, mesh, sides, near, sample_offsets(samples), 128, depth, owner)
    return covered, owner


def flat(points, w=1.0):
    """Homogeneous pixels of points (n, 2) at distance w."""
    return np.column_stack([points, np.ones(len(points))]) * np.broadcast_to(w, len(points))[:, None]


@pytest.mark.parametrize("samples", [1, 4, 8, 16])
def test_area_matches_covered_samples(samples):
    # Jarnik: a closed curve of length L >= 1 holds N lattice points with |N - A| < L. Each of the
    # sample positions is one such lattice; rounding to 1/256 pixel moves the area by less than L/256.
    random = np.random.default_rng(1)
    for _ in range(200):
        p = random.uniform(2, SIZE - 2, (3, 2))
        area = 0.5 * abs(np.linalg.det(np.column_stack([p[1] - p[0], p[2] - p[0]])))
        length = sum(np.linalg.norm(p[i] - p[i - 1]) for i in range(3))
        covered, _ = draw(flat(p), [0, 1, 2], samples)
        assert abs(covered - samples * area) < samples * (length + length / 256)


@pytest.mark.parametrize("seed", range(5))
def test_triangulation_covers_every_sample_once(seed):
    # Points on sample positions and on pixel corners too: the cases where rounding decides.
    random = np.random.default_rng(seed)
    points = random.uniform(0, SIZE, (150, 2))
    points[:60] = np.floor(points[:60]) + 0.5
    points[60:90] = np.floor(points[60:90] * 16) / 16
    points = np.unique(np.vstack([points, [[-9, -9], [SIZE + 9, -9], [-9, SIZE + 9], [SIZE + 9, SIZE + 9]]]), axis=0)
    rounded = np.round(points * 256) / 256
    faces = Delaunay(rounded).simplices
    faces[::2] = faces[::2, ::-1]  # orientation must not matter for two-sided cloth
    for samples in (1, 8):
        covered, owner = draw(flat(rounded), faces, samples)
        assert covered == SIZE * SIZE * samples
        assert (owner >= 0).all()


def test_nearest_surface_wins_whatever_the_order():
    # Two triangles that cross: 1/w is affine on the screen, so the front one follows from it.
    p = np.array([[-40.0, -40.0], [260.0, -40.0], [-40.0, 260.0]])
    depths = [np.array([2.0, 6.0, 3.0]), np.array([2.6, 2.0, 4.0])]
    clip = np.vstack([flat(p, w) for w in depths])
    _, owner = draw(clip, [[0, 1, 2], [3, 4, 5]])
    _, swapped = draw(clip, [[3, 4, 5], [0, 1, 2]])
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    s, t = (x + 40) / 300, (y + 40) / 300
    inverse = [(1 - s - t) / w[0] + s / w[1] + t / w[2] for w in depths]
    clear = np.abs(inverse[0] - inverse[1]) > 1e-6
    expected = np.where(inverse[0] > inverse[1], 0, 1)
    assert 0.2 < expected.mean() < 0.8
    assert (owner[..., 0] == expected)[clear].all()
    assert (swapped[..., 0] == 1 - expected)[clear].all()


def test_triangle_that_crosses_the_near_plane_covers_what_is_in_front():
    # The floor y = 1 below an eye at the origin looks like the half plane under the horizon, up
    # to where it ends; one corner lies far behind the eye.
    focal, middle = 40.0, SIZE / 2
    corners = np.array([[-400.0, 1.0, 50.0], [400.0, 1.0, 50.0], [0.0, 1.0, -400.0]])
    x, y, z = corners.T
    clip = np.column_stack([focal * x + middle * z, focal * y + middle * z, z])
    _, owner = draw(clip, [0, 1, 2])
    rows = np.arange(SIZE) + 0.5
    distance = np.divide(focal, rows - middle, out=np.full(SIZE, np.inf), where=rows > middle)
    seen = (owner[..., 0] == 0).all(axis=1)
    assert (seen == (distance < 50.0)).all()
    assert ((owner[..., 0] == 0).any(axis=1) == seen).all()


def test_nothing_behind_the_eye_is_drawn():
    clip = flat(np.array([[5.0, 5.0], [60.0, 5.0], [5.0, 60.0]]), -1.0)
    assert draw(clip, [0, 1, 2])[0] == 0


def test_one_sided_triangles_show_one_side():
    p = flat(np.array([[5.0, 5.0], [60.0, 5.0], [5.0, 60.0]]))
    front, back = draw(p, [0, 2, 1], two_sided=False)[0], draw(p, [0, 1, 2], two_sided=False)[0]
    assert front == draw(p, [0, 1, 2])[0] > 0
    assert back == 0


PLAIN = {"ground": "none", "sheen": 0.0, "samples": 1}


def grid(n, half, normal=(0.0, 0.0, 1.0), white=True):
    """A square sheet of n x n vertices around the origin, and its uv."""
    normal = np.array(normal) / np.linalg.norm(normal)
    u = np.cross([0.0, 1.0, 0.0], normal)
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    s, t = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    i, j = np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + n], 1), np.stack([a + 1, a + n + 1, a + n], 1)]).astype(np.int32)
    points = half * (s[..., None] * u + t[..., None] * v).reshape(-1, 3)
    return Mesh(points, faces, colours=np.ones((n * n, 3)) if white else None)


def sphere(centre, radius, rows=48, columns=96):
    """A closed sphere, its corners on the true surface."""
    latitude = np.linspace(-math.pi / 2, math.pi / 2, rows)[:, None]
    longitude = (np.arange(columns) * 2 * math.pi / columns)[None]
    x, y = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)
    points = np.stack([x, y, np.sin(latitude) + 0 * longitude], -1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns), indexing="ij")
    a, b = (i * columns + j).ravel(), (i * columns + (j + 1) % columns).ravel()
    faces = np.concatenate([np.stack([a, b, a + columns], 1), np.stack([b, b + columns, a + columns], 1)])
    return Mesh(np.array(centre) + radius * points, faces.astype(np.int32), two_sided=False)


def above(height=10.0, size=(160, 160), half=1.0):
    """A camera that looks straight down on [-half, half]^2."""
    fov = 2 * math.atan(half / height)
    return Camera(np.array([0.0, 0.0, height]), np.zeros(3), np.array([0.0, 1.0, 0.0]), fov, size)


def sky(up):
    return (SKY + GROUND) / 2 + (SKY - GROUND) * up / 3


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.0, 1.3])
@pytest.mark.parametrize("n", [2, 40])
def test_white_plane_has_the_radiance_of_its_tilt(tilt, n):
    # Lambert: the key light times the cosine, plus the sky's integral; and neither the shadow nor
    # the occlusion of the plane by itself, at any slope.
    light = (math.sin(tilt), 0.0, math.cos(tilt))
    picture = radiance(RasterConfig(light=light, **PLAIN), [grid(n, 2.0)], above())
    expected = KEY * math.cos(tilt) + sky(1.0)
    assert np.abs(picture / expected - 1).max() < 1e-5


def test_plane_that_faces_away_has_sky_light_alone():
    picture = radiance(RasterConfig(light=(0.3, 0.0, -1.0), **PLAIN), [grid(2, 2.0)], above())
    assert np.abs(picture / sky(1.0) - 1).max() < 1e-5


def test_bytes_are_the_radiance_through_shoulder_and_srgb():
    config = RasterConfig(light=(0.0, 0.0, 1.0), **PLAIN)
    grey = grid(2, 2.0)
    grey = Mesh(grey.vertices, grey.faces, colours=np.tile([0.1, 0.4, 1.0], (4, 1)))
    value = (KEY + sky(1.0)) * [0.1, 0.4, 1.0]
    value = np.where(value > 0.8, 1 - 0.2 * np.exp((0.8 - value) / 0.2), value)
    picture = Raster().render(config, [grey], above())
    assert np.abs(picture.astype(int) - np.rint(255 * to_srgb(value))).max() <= 1


@pytest.mark.parametrize("elevation", [90.0, 60.0, 40.0])
def test_shadow_of_a_sphere_is_the_predicted_ellipse(elevation):
    # Parallel light at elevation e: semi-axes r across and r / sin e along, centre moved by h / tan e.
    # Pixels in which the camera above sees the sphere itself are left out.
    radius, height, e = 0.25, 0.5, math.radians(elevation)
    light = (math.cos(e), 0.0, math.sin(e))
    start = height / math.tan(e)
    size, half = 200, 1.2
    camera = above(40.0, (size, size), half)
    ball = sphere((start, 0.0, height), radius)
    config = RasterConfig(light=light, light_size=0.0, occlusion=False, **PLAIN)
    picture = radiance(config, [grid(30, half), ball], camera)
    lit = (picture - sky(1.0))[..., 0] / (KEY[0] * math.sin(e))
    y, x = np.mgrid[size:0:-1, :size] - np.array([0.5, -0.5]).reshape(2, 1, 1)
    x, y = (x / size * 2 - 1) * half, (y / size * 2 - 1) * half
    place = np.hypot(x * math.sin(e), y) / radius
    free = np.hypot(x - start, y) > radius * 1.05
    edge = 4 * (2.02 * half * math.sqrt(2) / 1024) / radius + 0.01
    inside, outside = free & (place < 1 - edge), free & (place > 1 + edge)
    if elevation < 90.0:
        assert inside.sum() > 200
        assert np.abs(lit[inside]).max() < 1e-5
    assert np.abs(lit[outside] - 1).max() < 1e-5


def test_checker_floor_is_perspective_correct():
    # A floor of two triangles, far longer than wide on the screen: affine interpolation of uv would
    # bend the checker at the diagonal. The pixel's ray meets z = 0 in closed form.
    cells, half = 8, 4.0
    image = np.zeros((256, 256, 3), np.uint8)
    image[(np.add.outer(np.arange(256) // 32, np.arange(256) // 32) % 2) == 0] = 255
    floor = grid(2, half)
    uv = (floor.vertices[:, :2] / (2 * half) + 0.5).astype(np.float32)
    camera = Camera(np.array([0.3, -6.5, 1.6]), np.array([0.0, 0.0, 0.2]), np.array([0.0, 0.0, 1.0]), 0.9, (240, 180))
    config = RasterConfig(light=(0.0, 0.0, 1.0), shadows=False, occlusion=False, **PLAIN)
    picture = radiance(config, [Mesh(floor.vertices, floor.faces, uv=uv, image=image)], camera)
    right, up, forward = axes(camera)
    y, x = np.mgrid[:180, :240] + 0.5
    focal = 90.0 / math.tan(camera.fov / 2)
    ray = forward + ((x - 120) / focal)[..., None] * right - ((y - 90) / focal)[..., None] * up
    with np.errstate(divide="ignore"):
        distance = -camera.eye[2] / ray[..., 2]
    place = (camera.eye + distance[..., None] * ray)[..., :2] / (2 * half) + 0.5
    on = (distance > 0) & (np.abs(place - 0.5).max(axis=-1) < 0.49)
    cell = place * cells
    footprint = np.maximum(np.abs(np.gradient(cell[..., 1], axis=0)), np.abs(np.gradient(cell[..., 0], axis=1)))
    margin = np.abs(cell - np.rint(cell)).min(axis=-1)
    sure = on & (footprint < 0.3) & (margin > 1.5 * footprint + 0.05)
    white = (np.floor(cell).astype(int).sum(axis=-1) % 2) == 0
    value = picture[..., 0] / (KEY[0] + sky(1.0)[0])
    assert sure.sum() > 4000
    assert np.abs(value - white)[sure].max() < 0.01


def test_distant_texture_tends_to_its_mean():
    # A checker finer than a pixel must become its mean in linear light, one half, not moire.
    image = np.zeros((256, 256, 3), np.uint8)
    image[(np.add.outer(np.arange(256), np.arange(256)) % 2) == 0] = 255
    sheet = grid(2, 1.0)
    uv = (sheet.vertices[:, :2] / 2 + 0.5).astype(np.float32)
    config = RasterConfig(light=(0.0, 0.0, 1.0), **PLAIN)
    picture = radiance(config, [Mesh(sheet.vertices, sheet.faces, uv=uv, image=image)], above(size=(61, 61)))
    assert np.abs(picture / (0.5 * (KEY + sky(1.0))) - 1).max() < 0.01


def test_background_is_the_gradient():
    config = RasterConfig()
    s = ((np.arange(60) + 0.5) / 60)[:, None]
    s = s * s * (3 - 2 * s)
    top, bottom = (parse_hex(colour) for colour in config.background)
    picture = radiance(config, [], above(size=(40, 60)))
    # Samples of a pixel are shaded together, at their mean place.
    assert np.abs(picture - (top + s * (bottom - top))[:, None]).max() < 1e-3


def test_enclosed_point_sees_no_sky_and_an_open_one_all_of_it():
    inner, outer = grid(30, 0.2), sphere((0.0, 0.0, 0.0), 1.0)
    shell = Mesh(outer.vertices, outer.faces, colours=np.ones((len(outer.vertices), 3)), two_sided=False)
    dark = Mesh(inner.vertices, inner.faces, colours=np.zeros((900, 3)) + 0.5)
    camera = above(0.5, (40, 40), 0.1)
    config = RasterConfig(light=(0.0, 0.0, 1.0), **PLAIN)
    assert radiance(config, [dark, shell], camera).max() < 1e-6
    free = radiance(config, [dark], camera)
    assert np.abs(free / (0.5 * (KEY + sky(1.0))) - 1).max() < 1e-5


def test_faces_that_are_not_finite_are_left_out():
    sheet, ball = grid(12, 1.0), sphere((0.0, 0.0, 0.6), 0.2)
    broken = sheet.vertices.copy()
    broken[5] = np.nan
    broken[77, 0] = np.inf
    kept = np.isfinite(broken).all(axis=1)[sheet.faces].all(axis=1)
    camera = frame([sheet, ball], size=(120, 90))
    config = RasterConfig()
    picture = Raster().render(config, [Mesh(broken, sheet.faces), ball], camera)
    expected = Raster().render(config, [Mesh(sheet.vertices, sheet.faces[kept]), ball], camera)
    assert (picture == expected).all()


def test_place_in_the_world_does_not_matter():
    sheet, ball = grid(12, 1.0), sphere((0.0, 0.0, 0.6), 0.2)
    camera = frame([sheet, ball], size=(120, 90))
    far = np.array([1e6, -2e6, 5e5])
    moved = [Mesh(m.vertices + far, m.faces, m.colours, two_sided=m.two_sided) for m in (sheet, ball)]
    there = Camera(camera.eye + far, camera.target + far, camera.up, camera.fov, camera.size)
    here, away = (Raster().render(RasterConfig(), *x).astype(int) for x in (([sheet, ball], camera), (moved, there)))
    assert np.mean(here != away) < 1e-3


def test_colour_bar_shows_the_map_itself():
    # The bar's pixels, left to right, are the colours that cloth of those values would be given.
    legend = Legend(label="stretch", low=0.0, high=0.05, format="percent")
    camera = above(size=(480, 360))
    plain = Raster().render(RasterConfig(), [], camera)
    marked = Raster().render(RasterConfig(legend=legend), [], camera)
    bar = np.rint(255 * to_srgb(colours(np.linspace(0.0, 0.05, 120), 0.0, 0.05)))
    rows = [row for row in marked if any((row[x : x + 120] == bar).all() for x in range(360))]
    assert len(rows) == 6
    changed = (plain != marked).any(axis=-1)
    assert not changed[:250].any()
    assert not changed[:, :300].any()


def test_label_longer_than_the_bar_ends_where_the_bar_does():
    legend = Legend(label="points within 15.9 mm, or so", low=0.0, high=1.0)
    camera = above(size=(240, 320))
    changed = Raster().render(RasterConfig(legend=legend), [], camera) != Raster().render(RasterConfig(), [], camera)
    columns = np.flatnonzero(changed.any(axis=(0, 2)))
    assert columns.max() <= 240 - 320 // 30 + 1
    assert columns.min() < 240 - 320 // 30 - 60


@pytest.mark.parametrize("rows", [10, 24, 60])
def test_convex_body_neither_shadows_nor_hides_itself(rows):
    # Its flat faces would, along the terminator, where the smooth normals still see the light:
    # without the correction this shows as steps, the more so the coarser the mesh.
    ball = sphere((0.0, 0.0, 0.0), 0.7, rows, 2 * rows)
    ball = replace(ball, colours=np.ones((len(ball.vertices), 3)))
    plain = {"light": (0.6, 0.0, 0.8), **PLAIN}
    alone = radiance(RasterConfig(**plain, shadows=False, occlusion=False), [ball], above())
    assert np.abs(radiance(RasterConfig(**plain), [ball], above()) - alone).max() < 1e-3
