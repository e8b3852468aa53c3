"""How rays of a scene pass the sheet: the rung and the effects, as planned once for the whole picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Rung
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.scene import Scene
from clacad.sheet.window import Window
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from clacad.effects import Plan
    from clacad.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Beyond:
    """Rays that carry light from behind the sheet to the camera.

    Attributes
    ----------
    parent : (m,) ints
        The launched ray each one belongs to.
    position, direction : (m, 3), window units
    flux : (m,)
    """

    parent: NDArray[np.intp]
    position: Floats
    direction: Floats
    flux: Floats


@dataclass(frozen=True, eq=False)
class Passage:
    """How rays pass the sheet.

    Attributes
    ----------
    rung : "law", "thin", "surfaces" or "mesh"
    shining : tuple of Fate
        Fates whose rays bring light where no effect but ghosts is on; all others are black.
    plan : Plan or None
        The effects; None for geometry alone.
    mesh : Mesh, str or None
        Rung mesh: the triangles.
    """

    rung: Rung
    shining: tuple[int, ...]
    plan: Plan | None = None
    mesh: Mesh | str | None = None

    @property
    def plain(self) -> bool:
        """Whether the trace alone says all: no effect beyond the labels of geometry, and no share of a law."""
        if self.plan is None:
            return True
        names = self.plan.traced()
        homogeneous = self.rung == "law" and (names or self.plan.rung_why != "as asked")
        return not homogeneous and set(names) <= {"ghosts"}

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that are on."""
        return () if self.plan is None else self.plan.names

    @property
    def homogeneous(self) -> bool:
        """Whether the sheet is nothing but its law."""
        return self.rung == "law" and self.plain

    def light(self, window: Window, rays: Rays, compiled: bool) -> tuple[Beyond, TraceResult]:
        """Trace a block of camera rays, on this thread alone, and give what shines."""
        path: Literal["numpy", "numba"] = "numba" if compiled else "numpy"
        options: dict[str, Any] = {} if self.mesh is None else {"mesh": self.mesh}
        if self.plain or self.plan is None:
            result = trace(window, rays, self.rung, threads=1, path=path, **options)
            rows = np.flatnonzero(np.isin(result.fate, self.shining))
            return Beyond(rows, result.position[rows], result.direction[rows], result.flux[rows]), result
        light, result = self.plan.light(window, rays, threads=1, path=path, **options)
        return Beyond(light.parent, light.position, light.direction, light.flux), result


def plan_passage(scene: Scene, window: Window) -> Passage:
    """Choose rung and effects of a still scene.

    Raises
    ------
    ValueError
        An unknown effect.
    """
    from clacad.effects import plan_effects

    plan = plan_effects(scene)
    mesh: Mesh | str | None = None
    if plan.rung == "mesh":
        from clacad.mesh import tessellate

        mesh = (
            scene.file(scene.sheet.mesh) if scene.sheet.mesh else tessellate(window, quads=scene.sheet.quads)
        )
    ghosts = (int(Fate.GHOST),) if "ghosts" in plan.names else ()
    return Passage(cast(Rung, plan.rung), (int(Fate.ALIVE), int(Fate.LAND), *ghosts), plan, mesh)


def geometry_alone(scene: Scene, direct: bool = False) -> Passage:
    """A passage without effects; `direct` shows nothing but light through corresponding lenslets."""
    rung: Rung = "surfaces" if scene.sheet.rung == "auto" else scene.sheet.rung
    return Passage(rung, (int(Fate.ALIVE),) if direct else (int(Fate.ALIVE), int(Fate.LAND)))
