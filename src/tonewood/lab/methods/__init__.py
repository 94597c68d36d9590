"""Methods of the literature beside the project's own, as arrays of a compiled loop."""

from tonewood.lab.methods.frequency import coupled_receptance as coupled_receptance
from tonewood.lab.methods.method import METHODS as METHODS
from tonewood.lab.methods.method import Method as Method
from tonewood.lab.methods.method import stability_limit as stability_limit
from tonewood.lab.methods.problem import Problem as Problem
from tonewood.lab.methods.step_map import StepMap as StepMap
from tonewood.lab.methods.step_map import exact as exact
from tonewood.lab.methods.step_map import system_map as system_map
