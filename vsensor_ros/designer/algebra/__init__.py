"""The algebra of functions: virtual sensors z = phi(x) where no linear map is enough."""

from vsensor_ros.designer.algebra.answer import Answer, Condition, Observer, System, Verdict
from vsensor_ros.designer.algebra.search import find

__all__ = ['Answer', 'Condition', 'Observer', 'System', 'Verdict', 'find']
