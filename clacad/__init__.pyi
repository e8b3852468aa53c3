"""Public names of clacad and the modules that define them; `clacad/__init__.py` reads the names from here."""

from clacad.advice.fewest_keys import fix as fix
from clacad.advice.hints import advise as advise
from clacad.advice.judged import check as check
from clacad.advice.proposal import design_for as design_for
from clacad.advice.wish import Wish as Wish
from clacad.config.mistakes import DesignError as DesignError
from clacad.design.model import Design as Design
from clacad.design.model import load as load
from clacad.effects.engine.plan import plan_effects as plan_effects
from clacad.effects.trace import Tracer as Tracer
from clacad.effects.trace import trace as trace
from clacad.explorer.write_page import explore as explore
from clacad.exporting.run import export as export
from clacad.imaging.image_by_rays import image as image
from clacad.measuring.measure import measure as measure
from clacad.measuring.measured import Measured as Measured
from clacad.mesh.body_mesh import Mesh as Mesh
from clacad.mesh.body_mesh import to_trimesh as to_trimesh
from clacad.mesh.tessellation import tessellate as tessellate
from clacad.optics.law.imaging import law_between as law_between
from clacad.optics.law.law import Fit as Fit
from clacad.optics.law.law import Law as Law
from clacad.optics.material.material import Material as Material
from clacad.optics.rays import Fate as Fate
from clacad.optics.rays import Rays as Rays
from clacad.optics.rays import TraceResult as TraceResult
from clacad.optics.sequence import Interface as Interface
from clacad.optics.sequence import trace_sequence as trace_sequence
from clacad.optics.surface.sag_and_normal import Biconic as Biconic
from clacad.optics.surface.sag_and_normal import Quadric as Quadric
from clacad.optimising.search import optimise as optimise
from clacad.prescription.prescribe import prescribe as prescribe
from clacad.rendering.picture import render as render
from clacad.rendering.picture import render_movie as render_movie
from clacad.report.better_faces import write_before_and_after as write_before_and_after
from clacad.report.notebook import as_html as as_html
from clacad.report.notebook import plot as plot
from clacad.sheet.lattice import Lattice as Lattice
from clacad.sheet.stack import Stack as Stack
from clacad.sheet.window import Body as Body
from clacad.sheet.window import Face as Face
from clacad.sheet.window import Window as Window
from clacad.solid.solids import solids as solids
from clacad.stacking.make_stack import stack as stack
from clacad.steering.scan import Scan as Scan
from clacad.steering.scan import steer as steer
from clacad.tracing.through_stack import trace_stack as trace_stack
from clacad.tracing.worst_cell import measure_light as measure_light
from clacad.verification.accuracy.accuracy_table import accuracy as accuracy
from clacad.verification.run import verify as verify
from clacad.verification.tolerance.parameter_sweep import sweep as sweep
from clacad.verification.tolerance.study import tolerance as tolerance
from clacad.waves.through_sheet import wave as wave

__version__: str
__all__: list[str]
