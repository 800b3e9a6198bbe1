"""The twin rotor live: its machine on topics, two sensors fail, and both actuators meanwhile."""

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import JointState
import yaml

from benchmark.twin_rotor import command, faults, FAULTY, moved, PLANT, SAMPLE
from vsensor_ros.designer.fault_design import fault_design
from vsensor_ros.node.cdr import decode
from vsensor_ros.plant import load_takagi_sugeno

REPLACER = Path(__file__).parents[2] / 'config/twin_rotor/replacer.yaml'
READINGS, COMMANDS = '/twin_rotor/joint_states', '/twin_rotor/command'
FIRST, LAST = 3500, 6700  # of the scenario's samples: one sensor fails at 5000, one at 6000


def flat(section, before=''):
    """Return nested parameters by their full names."""
    return {name: value for key, part in section.items() for name, value in (
        flat(part, f'{before}{key}.') if isinstance(part, dict) else {f'{before}{key}': part}
    ).items()}


def sample_of(message):
    """Return the time [ns] of its sample: each stamp that goes out is newer than the last."""
    period = round(SAMPLE * 1e9)
    stamp = message.header.stamp
    return (stamp.sec * 10**9 + stamp.nanosec) // period * period


def joints(x):
    """Return a message of what the six sensors say (6,)."""
    yaw, yaw_rate, tail, pitch, pitch_rate, main = x.tolist()
    return JointState(name=['yaw', 'pitch', 'tail_rotor', 'main_rotor'],
                      position=[yaw, pitch, 0.0, 0.0], velocity=[yaw_rate, pitch_rate, tail, main])


@pytest.mark.slow
def test_failed_rates_are_corrected_and_faults_of_all_are_told(rig, tmp_path):
    pytest.importorskip('cvxpy')
    made = fault_design(load_takagi_sugeno(PLANT), [*FAULTY, 'u_h', 'u_v'], [0.012])
    made.save(tmp_path / 'rotor.json')
    given = flat(yaml.safe_load(REPLACER.read_text())['/**']['ros__parameters'])
    r = rig({**given, 'design_file': str(tmp_path / 'rotor.json'), 'time_constant': 0.0})
    heard = r.listen('sensor_msgs/msg/JointState', READINGS)
    told = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/replacer/estimates',
                    ReliabilityPolicy.BEST_EFFORT)
    rng, x, before, faulty = np.random.default_rng(5), np.zeros(6), np.zeros(2), set()
    truth = {}  # by stamp [ns]: rates, and faults of sensors and inputs
    for k in range(FIRST, LAST):
        w = rng.normal(size=12)
        w *= rng.random()**(1 / 12) / np.linalg.norm(w) / np.sqrt(2)
        u, y = command(k), x + 0.05 * w[6:]
        fa, fs = faults(k, u)
        y[[1, 4]] += fs
        stamp = r.now + round(SAMPLE * 1e9)
        truth[stamp] = x[1], x[4], *fs, *before
        moment = {'sec': stamp // 10**9, 'nanosec': stamp % 10**9}
        given = JointState(name=['tail_rotor', 'main_rotor'], effort=u.tolist())
        given.header.stamp.sec, given.header.stamp.nanosec = moment['sec'], moment['nanosec']
        count = r.taken[COMMANDS]
        r.publisher(JointState, COMMANDS).publish(given)
        assert r.spin_until(lambda count=count: r.taken[COMMANDS] > count)
        if faulty != (faulty := {name for name, size in zip(FAULTY, fs) if size}):
            r.publisher(DiagnosticArray, '/isolation').publish(DiagnosticArray(status=[
                DiagnosticStatus(name=name, level=b'\x02' if name in faulty else b'\x00')
                for name in made.sensors]))
            assert r.spin_until(lambda: r.reported == faulty)
        r.step((f'{READINGS}_raw', joints(y)))
        x, before = moved(x, u + fa) + 0.01 * w[:6], fa

    states = r.told()
    assert {states[name].source for name in FAULTY} == {'virtual'}
    assert states['yaw'].source == 'real' and not states['yaw_rate'].outside_region
    failed = r.now - (LAST - 5001) * round(SAMPLE * 1e9)  # when yaw_rate was isolated
    both = failed + 1000 * round(SAMPLE * 1e9)
    off, healthy = [], 0
    for message in (decode(JointState, raw) for raw in heard):
        at = sample_of(message)
        rates = message.velocity[:2]
        if at > both:
            off.append(np.subtract(rates, truth[at][:2]))
        elif failed < at < both:
            assert abs(rates[0] - truth[at][0]) < 0.2
            healthy += abs(rates[1] - truth[at][1]) <= 0.05  # a reading, with its noise
    assert healthy > 900 and len(off) > 650
    assert (np.sqrt(np.mean(np.square(off), axis=0)) < 0.022).all()

    names = {*FAULTY, *(f'fault.{name}' for name in (*FAULTY, 'u_h', 'u_v'))}
    errors = {name: [] for name in names}
    for message in (decode(DiagnosticArray, raw) for raw in told):
        at = sample_of(message)
        if at <= both:
            continue
        for status in message.status:
            if status.name in names and not status.message:
                said = {v.key: float(v.value) for v in status.values}
                true = dict(zip((*FAULTY, *(f'fault.{n}' for n in (*FAULTY, 'u_h', 'u_v'))),
                                truth[at]))[status.name]
                # of a sensor's fault its reading is told, which has noise
                more = 0.05 if status.name in [f'fault.{n}' for n in FAULTY] else 0.0
                assert said['low'] - more <= true <= said['high'] + more
                errors[status.name].append(said['value'] - true)
    assert min(map(len, errors.values())) > 600
    rms = {name: np.sqrt(np.mean(np.square(one))) for name, one in errors.items()}
    assert rms['fault.u_h'] < 1e-4 and rms['fault.u_v'] < 5e-4
    assert max(rms[f'fault.{name}'] for name in FAULTY) < 0.025
