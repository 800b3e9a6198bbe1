"""The run: every virtual sensor in step on one grid of times."""

from vsensor_ros.bank.angle import Angle
from vsensor_ros.bank.bank import Bank
from vsensor_ros.bank.commands import End
from vsensor_ros.bank.estimates import Disagreement
from vsensor_ros.bank.flights import GUARD, LONGEST_GUARD
from vsensor_ros.bank.record import Rehearsal
from vsensor_ros.bank.residuals import Residuals

__all__ = ['GUARD', 'LONGEST_GUARD', 'Angle', 'Bank', 'Disagreement', 'End', 'Rehearsal',
           'Residuals']
