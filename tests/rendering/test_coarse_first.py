"""What an eye sees: coarse at once, fine after, and the mean of all effects in both."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clacad.base.machine_rates import Span
from clacad.cli import main
from clacad.prescription.prescribe import prescribe
from clacad.rendering import picture_cost
from clacad.rendering.camera import aim
from clacad.rendering.picture import EyeRequest, Picture, eye_scene, view_through
from clacad.rendering.picture_cost import BROAD, CoarseView, _again, _broad, _spread, enlarge, view_coarsely
from clacad.rendering.picture_cost import PIXELS_A_BLOCK as BLOCK
from clacad.rendering.sheet_passage import plan_passage
from clacad.rendering.view import set_up

DESIGN = Path(__file__).parents[2] / "designs" / "window-100mm.toml"
FEW = ("lattice.count=[6, 6]",)


@pytest.fixture
def photo(tmp_path):
    """A photograph: a slope of grey across, in colours that differ down."""
    down, across = np.mgrid[:120, :160]
    Image.fromarray(np.stack([across + 50, down + 90, 0 * down + 120], -1).astype(np.uint8)).save(
        tmp_path / "photo.png"
    )
    return tmp_path / "photo.png"


def test_what_is_linear_is_enlarged_to_what_is_linear():
    y, x = np.mgrid[:6, :9]
    found = enlarge(2.0 * x - 3.0 * y + 1.0, (48, 72))
    fine_y, fine_x = (np.mgrid[:48, :72] + 0.5) / 8 - 0.5
    inner = (slice(4, -4), slice(4, -4))
    np.testing.assert_allclose(found[inner], (2.0 * fine_x - 3.0 * fine_y + 1.0)[inner], atol=1e-12)
    assert enlarge(np.full((1, 1, 3), 7.0), (5, 4)).tolist() == np.full((5, 4, 3), 7.0).tolist()


def test_broad_sums_are_those_of_the_blocks_about_each():
    blocks = np.random.default_rng(0).normal(size=(7, 4, 3))
    half = BROAD // 2
    for k in range(7):
        for n in range(4):
            about = blocks[max(0, k - half) : k + half + 1, max(0, n - half) : n + half + 1]
            np.testing.assert_allclose(_broad(blocks)[k, n], about.sum(axis=(0, 1)), atol=1e-12)


def test_light_of_blocks_at_the_sheets_edge_is_that_of_the_sheet_and_none_beside_it():
    on = np.zeros((64, 64), dtype=bool)
    on[11:50, 13:60] = True
    blocks = on.reshape(8, 8, 8, 8).mean(axis=(1, 3))[..., None] * np.array([0.3, -0.1, 0.0])
    found = _spread(blocks, on)
    np.testing.assert_allclose(found[on], np.tile([0.3, -0.1, 0.0], (on.sum(), 1)), atol=1e-12)
    assert not found[~on].any()


def test_the_fine_picture_adds_the_difference_of_the_coarse_ones(photo, monkeypatch):
    scene = eye_scene(EyeRequest(DESIGN, photo, pixels=96, samples=16), FEW)
    window = prescribe(scene.design())
    full = plan_passage(scene, window)

    def drawn(still, passage, **_):
        """Fine stripes, and of the whole passage a slope that the cheaper one lacks, on the sheet's pixels alone."""
        width, height = still.camera.pixels
        y, x = (np.mgrid[:height, :width] + 0.5) / width
        on = (abs(x - 0.5) < 0.4) & (abs(y - 0.5) < 0.4)  # the frame is a quarter wider than the sheet
        light = np.where(x * 96 % 2 < 1, 0.3, 0.5) if width == 96 else np.full((height, width), 0.4)
        light = light + (passage is full) * on * 0.01 * (1.0 + x - 2.0 * y)
        return Picture(
            np.stack([light] * 3, -1), np.full((height, width), 16), 0 * light, still, passage, window
        )

    monkeypatch.setattr(picture_cost, "view_through", drawn)
    fine = view_coarsely(scene, full).refined().light
    y, x = (np.mgrid[:96, :96] + 0.5) / 96
    stripes = np.where(x * 96 % 2 < 1, 0.3, 0.5)
    slope = 0.01 * (1.0 + x - 2.0 * y)
    inner = np.s_[36:60, 36:60]  # where all blocks of every mean lie on the sheet
    np.testing.assert_allclose(fine[inner], (stripes + slope)[inner][..., None] * np.ones(3), atol=1e-12)
    np.testing.assert_array_equal(fine[:9], (stripes[..., None] * np.ones(3))[:9])  # around the sheet


@pytest.mark.slow
def test_the_fine_picture_has_the_mean_of_all_effects(photo):
    scene = eye_scene(EyeRequest(DESIGN, photo, pixels=64, samples=16), FEW)
    passage = plan_passage(scene, prescribe(scene.design()))
    coarse = view_coarsely(scene, passage)
    assert coarse.blockwise == ("reflections",)  # walls change too much of the light, diffraction turns it
    fine = coarse.refined()
    whole = view_through(scene, passage=passage, compiled=True)
    on = np.s_[14:50, 14:50]  # well within the sheet
    off = abs((fine.light - whole.light)[on].mean(axis=(0, 1)))
    assert off.max() < 4.0 * np.sqrt((fine.error**2 + whole.error**2)[on].mean() / (36 / BLOCK) ** 2)
    np.testing.assert_array_equal(fine.light[:4], whole.light[:4])  # around the sheet nothing is added
    assert fine.blockwise == (("reflections", BLOCK * BROAD),)


def test_the_coarse_picture_is_there_before_the_fine_one_is_drawn(photo, tmp_path, monkeypatch, capsys):
    seen = {}

    def stopped(self, **_):
        seen["coarse"] = Image.open(tmp_path / "eye.png").text["clacad:coarse"]
        raise KeyboardInterrupt

    monkeypatch.setattr(CoarseView, "refined", stopped)
    monkeypatch.setattr(
        import_module("clacad.rendering.picture_cost"), "picture_seconds", lambda *_: Span(5.0, 9.0)
    )
    asked = ["render", "--preset", "eye", str(DESIGN), str(photo), "-o", str(tmp_path / "eye.png"), "--pixels", "40",
             "--samples", "2", "--set", FEW[0]]  # fmt: skip
    assert main(asked) == 130
    assert seen["coarse"] == "the whole view in blocks of 8 x 8 pixels"
    said = capsys.readouterr().err
    assert "is coarse as yet" in said
    assert "this takes " in said  # the forecast
    # what may not be replaced, or cannot be written, is refused before anything is drawn
    monkeypatch.setattr(import_module("clacad.rendering.picture_cost"), "view_coarsely", None)
    assert main(asked) == 4
    assert "eye.png exists" in capsys.readouterr().err
    asked[asked.index("-o") + 1] = str(photo / "eye.png")
    assert main(asked) == 4
    assert "is a file; a folder is needed there" in capsys.readouterr().err


def test_a_forecast_counts_the_samples_that_a_noise_target_takes(photo):
    scene = eye_scene(EyeRequest(DESIGN, photo, pixels=48, samples=4), FEW)
    plain = scene.replace({"effects.mode": "none"})
    noisy = plain.replace({"camera.noise": 0.004, "camera.most_samples": 64})
    window = prescribe(scene.design())
    passage = plan_passage(plain, window)
    drawn = view_through(noisy, passage=passage, compiled=False)
    viewing = set_up(noisy, window, False, passage)
    found = _again(viewing, noisy, aim(noisy.camera))
    assert drawn.samples.mean() > 6.0  # most pixels are taken again
    assert found == pytest.approx(drawn.samples.mean() / 4.0, rel=0.6)
    assert _again(viewing, plain, aim(plain.camera)) == 1.0


SCENE = """
format = 1
name = "small"
unit = "mm"
[sheet]
design = "window-100mm.toml"
rung = "surfaces"
[camera]
position = [0, 0, -60]
frame = 5
pixels = [40, 30]
samples = 2
[[object]]
id = "floor"
kind = "checker"
height = -2
tile = 3
[effects]
mode = "none"
"""


@pytest.fixture
def scene_file(tmp_path):
    (tmp_path / "small.toml").write_text(SCENE)
    (tmp_path / DESIGN.name).write_text(DESIGN.read_text())
    return tmp_path / "small.toml"


def test_a_scene_whose_kernels_must_be_compiled_is_there_coarsely_first(
    scene_file, tmp_path, monkeypatch, capsys
):
    words = ["render", str(scene_file), "-o", str(tmp_path / "x.png")]
    assert main([*words, "--json"]) == 0
    whole = (tmp_path / "x.png").read_bytes()
    seen = {}

    def forecast(*_):
        with Image.open(tmp_path / "x.png") as coarse:
            seen["coarse"], seen["size"] = coarse.text["clacad:coarse"], coarse.size
        return Span(5.0, 9.0)

    monkeypatch.setattr(picture_cost, "must_compile", lambda *_: True)
    monkeypatch.setattr(import_module("clacad.rendering.picture_cost"), "picture_seconds", forecast)
    assert main(words) == 4  # nothing is drawn over the existing file
    assert main([*words, "--overwrite"]) == 0
    assert seen == {"coarse": "the whole view in blocks of 8 x 8 pixels", "size": (40, 30)}
    assert "compiled first" in capsys.readouterr().err
    assert (tmp_path / "x.png").read_bytes() == whole
    (tmp_path / "x.png").unlink()
    assert main(words) == 0  # what replaces the coarse picture is no overwriting
    assert (tmp_path / "x.png").read_bytes() == whole


@pytest.mark.slow
def test_a_movie_whose_kernels_must_be_compiled_is_its_first_frame_before(
    scene_file, monkeypatch, tmp_path, capsys
):
    film = tmp_path / "x.gif"
    moving = (
        '[animation]\nframes = 3\nfps = 5\n[[animation.move]]\nkey = "camera.position.0"\nfrom = 0\nto = 1\n'
    )
    scene_file.write_text(SCENE + moving)
    words = ["render", str(scene_file), "-o", str(film)]
    assert main(words) == 0
    whole, _ = film.read_bytes(), capsys.readouterr()
    seen, asked = {}, []

    def forecast(*_):
        with Image.open(film) as coarse:
            seen["frames"], seen["size"] = getattr(coarse, "n_frames", 1), coarse.size
            found = np.asarray(coarse.convert("RGB")).reshape(-1, 3)
            seen["colours"] = len(np.unique(found, axis=0))
        return Span(5.0, 9.0)

    monkeypatch.setattr(picture_cost, "must_compile", lambda *given: asked.append(given[2:]) or True)
    monkeypatch.setattr(import_module("clacad.rendering.picture_cost"), "picture_seconds", forecast)
    assert main(words) == 4  # nothing is drawn over the existing file
    assert film.read_bytes() == whole
    film.unlink()
    assert main(words) == 0
    assert (seen["frames"], seen["size"]) == (1, (40, 30))
    assert 1 < seen["colours"] <= 5 * 4  # blocks of 8 pixels a side
    assert asked[0] == (3,)  # all frames together are what is worth compiling for
    said = capsys.readouterr().err
    assert "the first of 3 frames as yet" in said
    assert "compiled first" in said
    assert film.read_bytes() == whole


@pytest.mark.parametrize("rung", ["surfaces", "law", "thin"])
def test_kernels_are_asked_for_by_the_types_that_they_are_called_with(rung, scene_file, monkeypatch):
    from clacad.base import kernel_cache
    from clacad.rendering.compiled import pixels
    from clacad.rendering.view import kernels_are_kept
    from clacad.scene import load_scene
    from clacad.tracing.compiled import chunk as kept_kernels

    scene = load_scene(scene_file, (f"sheet.rung={rung}",))
    viewing = set_up(scene, prescribe(scene.design()), True)
    asked, called = [], []
    for module in (kernel_cache, kept_kernels):
        monkeypatch.setattr(
            module, "is_kept", lambda kernel, arguments: asked.append((kernel, arguments)) or True
        )
    assert kernels_are_kept(viewing, aim(scene.camera))
    kernel, types = asked[0][0], [kernel_cache.numba.typeof(one) for one in asked[0][1]]
    if viewing.pane is None:
        assert kernel.py_func.__name__ == "look_all"
        return
    monkeypatch.setattr(pixels, "sample_all", lambda *arguments: called.append(arguments))
    view_through(scene, compiled=True)
    assert {tuple(kernel_cache.numba.typeof(one) for one in arguments) for arguments in called} == {
        tuple(types)
    }


def test_a_small_picture_needs_no_kernel(scene_file):
    from clacad.scene import load_scene

    scene = load_scene(scene_file)
    assert not picture_cost.must_compile(scene, plan_passage(scene, prescribe(scene.design())))
