"""Laws and directions on which a law written in slopes or angles fails; each with its reason."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin


@dataclass(frozen=True)
class HardLaw:
    """A law (η_x, η_y, δ_x, δ_y, φ, θ, ψ), a direction, and why they are hard."""

    name: str
    why: str
    law: tuple
    direction: tuple
    axes: str = "fixed"
    undecidable: bool = False  # refusal and answer are both right

    @property
    def upright(self):
        """Whether no turn is made, so that every component keeps its relative accuracy."""
        return self.law[5] == 0 and self.law[4] + self.law[6] == 0


def law(eta_x, eta_y, delta_x=0.0, delta_y=0.0, phi=0.0, theta=0.0, psi=0.0):
    """The seven numbers."""
    return (eta_x, eta_y, delta_x, delta_y, phi, theta, psi)


def beyond(angle, theta=pi / 6):
    """A direction in the y-z plane, 90 degrees plus `angle` from the axis of a lens tilted by `theta`."""
    return (0.0, sin(pi / 2 - theta + angle), cos(pi / 2 - theta + angle))


PAPER = law(-0.25, -1.0)
LAWS = [
    HardLaw("paper, on axis", "exact zeros must stay", PAPER, (0, 0, 1)),
    HardLaw("negative zeros", "-0 must not become a sign", PAPER, (-0.0, -0.0, 1)),
    HardLaw("not normalised, huge", "squares overflow", law(-0.25, -1, 0.01, 0.02), (3e199, -2e199, 1e200)),
    HardLaw("not normalised, tiny", "squares underflow", law(-0.25, -1, 0.01, 0.02), (3e-201, -2e-201, 1e-200)),
    HardLaw("subnormal direction", "digits are missing already", law(-0.25, -1, 0.01, 0.02), (5e-320, 1e-321, 9e-320)),
    HardLaw("grazing 89.999 degrees", "slopes of 6e4 amplify", law(-0.25, -1, 0.01, -0.02), (0.8660254036525354, 0.49999999992384564, 1.745e-5)),
    HardLaw("grazing 1e-200", "the slope overflows when squared", law(-0.25, -1, 0.01, -0.02), (1.0, 0.5, 1e-200)),
    HardLaw("eta 1e6", "|η| much above 1: the exit hugs the axis", law(1e6, -1e6, 0.1, 0.2), (0.3, 0.1, 1)),
    HardLaw("eta 1e-6", "|η| much below 1: a cancelled numerator times 1e6", law(-1e-6, 1e-6, 0.003, 0), (0.0029999999, 1e-12, 1)),
    HardLaw("eta 1e200 and 1e-200", "the two axes 400 decades apart", law(1e200, -1e-200), (1e-3, 1e-210, 1)),
    HardLaw("eta to 0 from above", "no lens pair at 0 itself", law(1e-300, 2e-300), (1e-302, -3e-302, 1)),
    HardLaw("eta to 0 from below", "the same, mirrored", law(-1e-300, -2e-300), (1e-302, -3e-302, 1)),
    HardLaw("eta 1 + 1e-6", "nearly a plane window", law(1 + 1e-6, 1 - 1e-6), (0.1, -0.2, 1)),
    HardLaw("eta next to 1", "1 - η is one rounding", law(1 - 2**-53, 1 + 2**-52, 1e-17, 0), (1e-17, 0.2, 1)),
    HardLaw("eta 1", "the identity, whatever the turn", law(1, 1, 0, 0, 0.3, 0.4, 0.5), (0.1, -0.2, 1)),
    HardLaw("eta 1 in one meridian", "a cylindrical pair", law(1, -1, 0, 0.1), (0.1, -0.2, 1)),
    HardLaw("eta 1 with an offset", "a prism: f1 is infinite", law(1, 1, 0.25, -0.5), (0.25, 0.1, 1)),
    HardLaw("Galilean", "f2 < 0: lens 2 diverges", law(0.25, 0.5, 0.01, -0.02), (0.05, 0.02, 1)),
    HardLaw("eta above 1", "f1 < 0: lens 1 diverges", law(4.0, 2.5, 0.01, -0.02), (0.05, 0.02, 1)),
    HardLaw("delta 1e160", "δ² overflows", law(-1e6, -1e6, 1e160, 5e159), (0.2, 0.1, 1)),
    HardLaw("delta 1e200 against eta 1e200", "huge over huge is ordinary", law(-1e200, -1e200, 1e200, -3e199), (0.2, 0.1, 1)),
    HardLaw("delta 1e-200", "δ² underflows", law(-0.3, 7, 1e-200, -2e-200), (5e-200, 1e-200, 1)),
    HardLaw("slope meets delta", "t - δ cancels to its last bits", law(-0.25, -1, 0.25, 0.1), (0.25 * (1 + 2**-50), 0.1, 1)),
    HardLaw("slope meets delta exactly", "only the rounding of 3 × 0.1 is left", law(-0.25, -1, 0.1, -0.1), (0.3, -0.3, 3.0)),
    HardLaw("slope meets delta, eta 1e-6", "what cancelled is multiplied by 1e6", law(-1e-6, -1, 0.003, 0), (0.0029850982707168056, 0.0995, 0.9950327569056019)),
    HardLaw("slope meets delta 1e-300, eta 1e-100", "error terms of products underflow", law(1e-100, -1, 1.7e-300, 0), (1.19e-300, 0.3, 0.7)),
    HardLaw("slope 1e-300 beside 1", "relative accuracy of a tiny component", law(-0.25, -1), (1e-300, 0.3, 1)),
    HardLaw("tilt 60 degrees", "slopes against the axis are large", law(-0.5, -1.5, 0.05, -0.1, 0, -pi / 3, 0.5), (-0.06, 0.34, 0.94)),
    HardLaw("tilt 60 degrees, turned back", "the exit runs towards -z", law(-0.5, -1.5, 0.05, -0.1, 0, pi / 3), (-0.06, 0.34, 0.94)),
    HardLaw("beyond the lens's hemisphere", "d·n < 0: slopes alone give a plausible wrong answer", law(0.5, 0.5, 0, 0, 0, pi / 4), (0, 0.72, 0.69)),
    HardLaw("1e-9 inside the hemisphere", "d·n = 1e-9 of d", law(-0.5, -0.5, 0, 0, 0, pi / 6), beyond(-1e-9)),
    HardLaw("1e-9 outside the hemisphere", "d·n = -1e-9 of d", law(0.5, 0.5, 0, 0, 0, pi / 6), beyond(1e-9)),
    HardLaw("on the edge of the hemisphere", "d·n is rounding only", law(-0.5, -0.5, 0, 0, 0, pi / 6), beyond(0.0), undecidable=True),
    HardLaw("along the sheet", "d_z = 0: neither forwards nor back", PAPER, (1, 0, 0)),
    HardLaw("towards -z", "backwards from the start", PAPER, (0.1, 0, -0.9)),
    HardLaw("zero direction", "no direction at all", PAPER, (0, 0, 0)),
    HardLaw("tilt 1e-9", "R differs from 1 by rounding in its diagonal", law(-0.25, -1, 0, 0, 0.7, 1e-9, 0.3), (0.01, 0.02, 1)),
    HardLaw("tilt 1e-200", "sin θ squared underflows", law(-0.25, -1, 0, 0, 0.7, 1e-200, 0.3), (0.01, 0.02, 1)),
    HardLaw("turned by 45 degrees", "both meridians mix", law(-0.25, -1, 0, 0, pi / 4), (-0.02, 0.03, 1)),
    HardLaw("turned by 90 degrees", "cos 90° is 6e-17 in doubles, 0 in truth", law(-0.25, -1, 0.1, 0, pi / 2), (0.02, 0.03, 1)),
    HardLaw("phi and psi cancel", "θ = 0: only φ + ψ means anything", law(-0.25, -1, 0.1, 0, 1.2, 0, -1.2), (0.1, 1e-9, 1)),
    HardLaw("phi and psi cancel, slope 1e-200", "R must be 1 exactly, not to rounding", law(-0.25, -1, 0, 0, 1.2, 0, -1.2), (1e-200, 0.3, 1)),
    HardLaw("degenerate Euler angles", "θ = 0 with φ ≠ -ψ", law(-0.25, -1, 0.1, 0, 1.2, 0, 0.4), (0.1, 0.2, 1)),
    HardLaw("a hundred turns", "angles far from 0 are reduced first", law(-0.25, -1, 0.1, 0, 200 * pi + 0.3, 0.01, -77.0), (0.1, 0.2, 1)),
    HardLaw("needle: eta_x / eta_y = 1e6", "the two stretches a million apart", law(1e-3, 1e3, 0.01, 0.01, 0.3, 0.1, 0.2), (0.1, -0.04, 1)),
    HardLaw("moving axes", "the other reading of the angles", law(-0.25, -1, 0.005, 0.01, 0.7, 0.2, -0.4), (0.1, 0.05, 1), axes="moving"),
]  # fmt: skip
