"""Light as a wave through one telescopelet: the far field behind it, compared with traced rays.

There are two methods with different ranges. In `exit_pupil` the exact trace gives exit points and optical
paths of rays, and Fraunhofer's integral gives the far field. It combines aberration with diffraction at lens
2's rim, but omits diffraction at lens 1's rim (valid for Fresnel numbers of 10 and more). `lens_planes` is
the band-limited angular spectrum through ideal lenses with rims: all diffraction, no aberration.
`through_sheet` uses the valid method and reports both. Interference between cells is not computed; for
identical cells in coherent light it follows from the pitch alone (`coherent_orders`).
"""

from __future__ import annotations

from clacad.waves.through_sheet import wave
from clacad.waves.wave_report import WaveReport

__all__ = ["WaveReport", "wave"]
