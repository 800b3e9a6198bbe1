"""
Hypothesis draws the same examples at every run; others with HYPOTHESIS_PROFILE=explore.

No deadline and no complaint of slow drawing: the machine may be busy.
"""

import os

from hypothesis import HealthCheck, settings

PATIENT = {'deadline': None, 'suppress_health_check': [HealthCheck.too_slow]}

settings.register_profile('fixed', derandomize=True, **PATIENT)
settings.register_profile('explore', **PATIENT)
settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'fixed'))
