"""What is wanted besides sensors goes out on ~/estimates, at each step while somebody listens."""

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy

from vsensor_ros import design, Plant
from vsensor_ros.node.cdr import decode


@pytest.fixture(name='file')
def _file(tmp_path):
    """Save a design of x' = -x + u1, read by three sensors, with x wanted, and y2's fault told."""
    plant = Plant.from_matrices([[-1.0]], [[1.0]], [[1.0], [2.0], [3.0]], states=['x'],
                                inputs=['u1'], sensors=['y1', 'y2', 'y3'], noise=[0.01] * 3)
    made = design(plant, [('y2',)], wanted={'x_wanted': [1.0]})
    record = type(made)(**{**vars(made), 'wanted': (*made.wanted, 'fault.y2', 'fault.u1')})
    record.save(tmp_path / 'wanted.json')
    return str(tmp_path / 'wanted.json')


def test_functionals_and_faults_are_told_before_and_after_isolation(rig, parameters, file):
    r = rig({**parameters, 'design_file': file})
    heard = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/replacer/estimates',
                     ReliabilityPolicy.BEST_EFFORT)

    def told():
        """Return what was said last of each name: its message, and its numbers."""
        r.spin(0.005)
        return {status.name: (status.message, {v.key: float(v.value) for v in status.values})
                for raw in heard for status in decode(DiagnosticArray, raw).status}
    r.command(1.5)
    r.step(*r.healthy(1.5, 3.0, 4.5), periods=30)
    message, said = told()['x_wanted']
    assert message == '' and said['value'] == pytest.approx(1.5, abs=1e-6)
    assert 0.0 < said['deviation'] < 0.1
    assert told()['fault.y2'][1]['value'] == pytest.approx(0.0, abs=1e-6)
    r.step(*r.healthy(1.5, 3.7, 4.5), periods=20)
    # not isolated yet: its fault shows, and whoever reads it is misled
    assert told()['fault.y2'][1]['value'] == pytest.approx(0.7, abs=1e-6)
    r.isolate('y2')
    r.step(*r.healthy(1.5, 3.7, 4.5), periods=20)
    found = told()
    assert found['y2'][1]['value'] == pytest.approx(3.0, abs=1e-6)
    assert found['fault.y2'][1]['value'] == pytest.approx(0.7, abs=1e-6)
    assert np.isfinite(found['fault.y2'][1]['deviation'])
    assert 'fault.u1' not in found  # nobody was designed for it


def test_a_fault_of_what_is_not_there_is_no_name(file, tmp_path):
    from vsensor_ros.bad_input import BadInput
    from vsensor_ros.observers import Design
    text = (tmp_path / 'wanted.json').read_text()
    for old, new, said in (('fault.y2', 'fault.y9', "wanted: 'fault.y9' is not a name"),
                           ('fault.y2', 'fault.u1', 'wanted: holds a name twice')):
        (tmp_path / 'bad.json').write_text(text.replace(old, new))
        with pytest.raises(BadInput, match=said):
            Design.load(tmp_path / 'bad.json')
