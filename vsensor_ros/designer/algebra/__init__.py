"""The algebra of functions: virtual sensors z = phi(x) where no linear map is enough."""

from vsensor_ros.designer.algebra.answer import Answer, Observer, System, Verdict

__all__ = ['Answer', 'Observer', 'System', 'Verdict']
