"""Methods of the literature beside the project's own, as matrices: for comparing accuracy and stability."""

from tonewood.lab.methods.frequency import coupled_receptance as coupled_receptance
from tonewood.lab.methods.integrators import METHODS as METHODS
from tonewood.lab.methods.integrators import Method as Method
from tonewood.lab.methods.integrators import exact as exact
from tonewood.lab.methods.integrators import stability_limit as stability_limit
from tonewood.lab.methods.problem import Problem as Problem
from tonewood.lab.methods.problem import StepMap as StepMap
from tonewood.lab.methods.problem import system_map as system_map
