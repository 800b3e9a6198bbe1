"""The run: every virtual sensor in step, and who serves each channel."""

from vsensor_ros.bank.bank import Bank
from vsensor_ros.bank.switch import Decision, Source, Switch

__all__ = ['Bank', 'Decision', 'Source', 'Switch']
