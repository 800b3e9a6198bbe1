from dataclasses import replace
from pathlib import Path
import sys

import pytest
from std_srvs.srv import SetBool, Trigger

sys.path.append(str(Path(__file__).parent))
from managed_rig import machines


@pytest.fixture
def machine(parameters):
    yield from machines(parameters)


@pytest.fixture
def for_a_time(parameters, plan, bench, tmp_path):
    path = tmp_path / 'for_a_time.json'
    replace(plan, sensors=('y1', 'y2'), inputs=(), entries={
        (('y1',), 'y1'): bench.encoder(rate=100.0, names=('y1', 'y2'))}).save(path)
    yield from machines({key: value for key, value in parameters.items()
                         if 'y3' not in key and 'u1' not in key} | {'design_file': str(path)})


@pytest.fixture
def running(machine):
    """Start a replacer whose sensors are all healthy and whose observers have converged."""
    def start(**more):
        m = machine(**more)
        m.drive()
        assert m.spin_until(lambda: source(m, 'y2') == 'real' and ready(m, 'y2'))
        return m
    return start


def state(m, name):
    return next(c for c in m.node.replacer.snapshot().channels if c.name == name)


def source(m, name):
    return m.node.replacer and state(m, name).source


def ready(m, name):
    with m.node.replacer.lock:
        return m.node.replacer.engine._bank.ready((name,), name)


def ask(m, name, **fields):
    response = m.call(SetBool if fields else Trigger, name, **fields)
    return response.success, response.message


def test_force_and_release(running):
    m = running(recovery__policy='hold')
    assert ask(m, 'y2/force', data=True) == (True, 'y2 is virtual: forced')
    assert ask(m, 'y2/force', data=True)[0]  # again does no harm
    assert ask(m, 'y2/clear') == (False, 'y2: is forced; release it')
    assert m.spin_until(lambda: state(m, 'y2').switches == 1)  # with the next message
    success, message = ask(m, 'y2/force', data=False)
    assert success and message.startswith('y2 is real')  # a busy computer may have more to say
    assert m.spin_until(lambda: state(m, 'y2').switches == 2)
    # y3 has no virtual sensor: forcing it would only do harm
    success, message = ask(m, 'y3/force', data=True)
    assert not success and message.startswith('y3: cannot be forced')
    assert source(m, 'y3') == 'real'


def test_a_force_that_would_wait_for_ever_is_refused_with_the_mend(for_a_time):
    """Its virtual sensor is one for a time, and no limit says for how long."""
    m = for_a_time()
    m.drive()
    assert m.spin_until(lambda: m.node.replacer and ready(m, 'y1'))
    assert ask(m, 'y1/force', data=True) == (False, (
        'y1: cannot be forced; nobody could speak for y1 without y1: it would serve for a time '
        'only, and no limit says for how long; give a tolerance or ranges in the plant file, or '
        'sensors.y1.max_deviation'))
    assert not state(m, 'y1').forced


def test_clear_gives_a_held_one_back_but_no_faulty_one(running):
    m = running(recovery__policy='hold', recovery__dwell=0.0)
    assert ask(m, 'y2/clear') == (True, 'y2 is real')  # nothing to clear
    m.isolate('y2')
    assert m.spin_until(lambda: source(m, 'y2') == 'virtual')
    success, message = ask(m, 'y2/clear')
    assert not success and message.startswith('y2: isolation still reports it faulty')
    m.isolate('')
    assert m.spin_until(lambda: state(m, 'y2').recovering_s >= 0.0)
    assert source(m, 'y2') == 'virtual'
    success, message = ask(m, 'y2/clear')  # a busy machine may add what it did not send on
    assert success and message.startswith('y2 is real')


def test_reset_releases_what_is_latched_or_forced(running):
    m = running(recovery__policy='latched', recovery__dwell=0.0)
    m.isolate('y2')
    assert m.spin_until(lambda: source(m, 'y2') == 'virtual')
    m.isolate('')
    assert m.spin_until(lambda: state(m, 'y2').recovering_s >= 0.0)
    assert ask(m, 'y2/clear') == (False, 'y2: is latched; reset the replacer')
    assert ask(m, 'reset') == (True, 'all are real')
    assert source(m, 'y2') == 'real'
    assert m.spin_until(lambda: ready(m, 'y2'))
    assert ask(m, 'y2/force', data=True)[0]
    assert ask(m, 'reset') == (True, 'all are real')


def test_while_it_is_not_active_nothing_is_done(running):
    m = running()
    m.change('deactivate')
    for name, fields in (('y2/force', {'data': True}), ('y2/clear', {}), ('reset', {})):
        assert ask(m, name, **fields) == (
            False, 'the replacer is not active; activate it first')
    assert not any(c.forced for c in m.node.replacer.snapshot().channels)
    m.change('cleanup')
    services = {s for s, _ in m.node.get_service_names_and_types_by_node('replacer', '/')}
    assert not {s for s in services if '/y2/' in s or s.endswith('/reset')}
