"""Designs and windows with replaced faces: unchecked trials of a search, or its checked result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from clacad.design import Design
from clacad.design.faces import FaceSpec, SearchRecord, face_table
from clacad.design.sections import OF_RECIPES
from clacad.prescription.given import given_surface
from clacad.sheet.window import Window


def given_design(
    design: Design, window: Window, faces: tuple[FaceSpec, ...], offset: tuple[float, float] | None,
    record: SearchRecord | None = None,
) -> Design:  # fmt: skip
    """Design with these faces and all values that its window fixed, checked as a design file is."""
    data = {key: dict(value) if isinstance(value, Mapping) else value for key, value in design.given.items()}
    pair = {key: value for key, value in data["pair"].items() if key not in (*OF_RECIPES, "search")}
    if design.pair.form != "slab":
        pair["thickness"] = list(window.recipe["T"])
    if offset is not None:
        pair["vertex"] = list(offset)
    pair["prescription"] = "given"
    pair["face"] = [face_table(face) for face in faces]
    if record is not None:
        pair["search"] = record.to_dict()
    return Design.from_dict({**data, "pair": pair})


def trial_design(
    design: Design, window: Window, faces: tuple[FaceSpec, ...], offset: tuple[float, float] | None
) -> Design:
    """Unchecked design with these faces, as a trial of the search."""
    thickness = design.pair.thickness if design.pair.form == "slab" else tuple(window.recipe["T"])
    given = replace(
        design.pair,
        prescription="given",
        face=faces,
        thickness=thickness,
        vertex=design.pair.vertex if offset is None else offset,
    )
    return replace(design, pair=given)


def with_faces(window: Window, faces: tuple[FaceSpec, ...]) -> Window:
    """Window with replaced surfaces."""
    made = iter(faces)
    bodies = []
    for body in window.bodies:
        front, back = (
            replace(face, surface=given_surface(spec, face.side)) if face.array is not None else face
            for face, spec in ((body.front, next(made)), (body.back, next(made)))
        )
        bodies.append(replace(body, front=front, back=back))
    return replace(window, bodies=tuple(bodies))
