"""Elastic models over the C++ kernels: energies of triangles as functions of six invariants each."""

from voile.elastic.evaluate import Evaluation, evaluate
from voile.elastic.models import BENDING, MATERIALS, MODELS, model_name

__all__ = ["BENDING", "MATERIALS", "MODELS", "Evaluation", "evaluate", "model_name"]
