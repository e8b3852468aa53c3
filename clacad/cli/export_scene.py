"""`clacad export` of a scene file: sheet and all, for POV-Ray."""

from __future__ import annotations

from pathlib import Path

from clacad.cli.console import show_json, show_text
from clacad.config.toml_text import top_keys


def is_scene(path: Path) -> bool:
    """Whether a file is a scene: it has a sheet, which no design has."""
    return "sheet" in top_keys(str(path))


def export_scene(
    path: Path, overrides: list[str], out: Path, *, overwrite: bool, json: bool, quiet: bool
) -> int:
    """Write a scene, sheet and all, for POV-Ray; of an animated scene the first frame."""
    from clacad.formats.pov.pov_scene import write_pov
    from clacad.prescription.prescribe import prescribe
    from clacad.rendering.atlas.make_atlas import manifest_of
    from clacad.scene import load_scene
    from clacad.storage.atomic import Stage, safe_name
    from clacad.storage.errors import NotPossible

    scene = load_scene(path, tuple(overrides))
    if len(scene.sheets) > 1:
        raise NotPossible(
            f"{path}: POV-Ray scenes hold one sheet, and this one has {len(scene.sheets)}; `clacad stack` writes their assembly, "
            "`clacad render` their picture"
        )
    still = scene.at(0) if scene.animation is not None else scene
    with Stage(out, overwrite=overwrite) as stage:
        name = f"{safe_name(still.name)}.pov"
        write_pov(prescribe(still.design()), stage.path(name), still)
        stage.publish(manifest_of(stage, "scene"))
    if json:
        show_json({"folder": str(out), "files": [name]})
    else:
        width, height = still.camera.pixels
        show_text(f"wrote {out / name}: povray +I{name} +W{width} +H{height} -A File_Gamma=1.0", quiet=quiet)
    return 0
