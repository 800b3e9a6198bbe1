"""The run: every virtual sensor in step, and who serves each channel."""

from vsensor_ros.bank.bank import Bank
from vsensor_ros.bank.bumpless import Bumpless
from vsensor_ros.bank.switch import Decision, Policy, Source, Switch

__all__ = ['Bank', 'Bumpless', 'Decision', 'Policy', 'Source', 'Switch']
