"""The run: every virtual sensor in step on one grid of times."""

from vsensor_ros.bank.bank import Bank

__all__ = ['Bank']
