"""The bridge between desk and machine: kinds of virtual sensors, and the file that holds them."""

from vsensor_ros.observers.kinds.functional.virtual_sensor import (
    Certificate,
    Design,
    Noise,
    OrderStep,
    Proof,
    Refusal,
    Rung,
    VirtualSensor,
)

__all__ = ['Certificate', 'Design', 'Noise', 'OrderStep', 'Proof', 'Refusal', 'Rung',
           'VirtualSensor']
