"""Light as a wave through one telescopelet: the far field behind it, beside what rays say of it.

Two ways, each exact where the other is not. `exit_pupil`: the exact trace tells where rays leave and how long their optical
paths are, and Fraunhofer's integral does the rest; aberration and diffraction at lens 2's rim together, but not what lens
1's rim does on the way (Fresnel numbers of 10 and more). `lens_planes`: the band-limited angular spectrum through ideal
lenses with rims; all diffraction, no aberration. `through_sheet` takes the one that holds and shows both. Cells do not
interfere here; what equal cells do in coherent light follows from the pitch alone (`coherent_orders`).
"""

from __future__ import annotations

from clacad.waves.through_sheet import wave
from clacad.waves.wave_report import WaveReport

__all__ = ["WaveReport", "wave"]
