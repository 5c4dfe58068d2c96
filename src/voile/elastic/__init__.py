"""Elastic models over the C++ kernels: energies of triangles as functions of six invariants each."""

from voile.elastic.evaluate import Evaluation, evaluate
from voile.elastic.models import BENDING, MATERIALS, MODELS, has_directors, is_woven, model_name, model_of

__all__ = [
    "BENDING",
    "MATERIALS",
    "MODELS",
    "Evaluation",
    "evaluate",
    "has_directors",
    "is_woven",
    "model_name",
    "model_of",
]
