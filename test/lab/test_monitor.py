"""The live view: what it shows of hand-made statuses, and that it hears real ones, late."""

import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import pytest
import rclpy
from rclpy.context import Context
from rclpy.qos import DurabilityPolicy, QoSProfile

from vsensor_ros.command.monitor import main
from vsensor_ros.lab import monitor
from vsensor_ros.lab.domain import reserved_domain
from vsensor_ros.lab.process import die_with_parent
from vsensor_ros.lab.screen import changes, duration, read_status, screen

WORDS = 'virtual (isolated), from y3, voltage, good to 0.02 rad/s; repair y2'
NO_SOURCE = 'no valid source (y3 silent for 0.5 s; nothing goes out); repair y4'
LEVELS = {'real': b'\x00', 'virtual': b'\x01', 'none': b'\x02', 'silent': b'\x03'}


def make_status(name, message, topic='', level=b'\x00', **facts):
    return DiagnosticStatus(name=name, message=message, hardware_id=topic, level=level, values=[
        KeyValue(key=key, value=str(value)) for key, value in facts.items()])


def channel(name, source='real', message='', **facts):
    known = {'value': 1.5, 'unit': 'rad/s', 'deviation': 0, 'offset': 0, 'switches': 0,
             'last_step': 'nan', 'since_s': 'nan', 'fault_set': '', 'grade': '', **facts}
    return make_status(name, message or source, '/joints', LEVELS[source], source=source, **known)


def served(name='y2', **facts):
    return channel(name, 'virtual', facts.pop('message', WORDS), **{
        'value': -1.0234, 'deviation': 0.0199, 'offset': 0.0012, 'switches': 3,
        'last_step': -0.00231, 'since_s': 35.2, 'fault_set': 'y2 y3', 'grade': 'exact', **facts})


def loop(**facts):
    return make_status('replacer', facts.pop('message', 'active'), **{
        'state': 'active', 'rate': 100, 'achieved': 99.981, 'step_p50': 0.000123,
        'step_p99': 0.000311, 'step_max': 0.00912, 'overruns': 0, 'faulty': '',
        'clock_backwards': 0, 'clock_stood_still': 0, **facts})


def told(*statuses):
    return read_status(DiagnosticArray(status=list(statuses)))


def text(lines):
    return [''.join(piece for piece, _ in line) for line in lines]


def show(*statuses, age=0.5, width=80, height=24):
    """Return the screen, which is never larger than the terminal."""
    lines = text(screen(told(*statuses), age, '/replacer', width, height))
    assert len(lines) <= height and all(len(line) <= width for line in lines)
    return lines


def style_of(lines, word):
    return next(style for line in lines for piece, style in line if piece.strip() == word)


def test_a_line_a_channel_and_words_on_what_is_not_well():
    head, pace, titles, y1, y2, words = show(channel('y1'), served(), loop(faulty='y2 y3'))
    assert head == '/replacer active   faulty: y2, y3'
    assert pace == ('99.98 of 100 Hz, step p50 0.12 p99 0.31 max 9.1 ms, 0 overruns, clock steady')
    assert titles.split() == ['SENSOR', 'SOURCE', 'VALUE', 'SERVED', 'BY', 'SINCE', 'SW', 'STEP',
                              'OFFSET']
    assert y1.split() == ['y1', 'real', '1.5', 'rad/s', '-', '-', '0', '-', '0']
    assert y2.split() == ['y2', 'virtual', '-1.023', '+-', '0.02', 'rad/s', '{y2,y3}', 'exact',
                          '35', 's', '3', '-0.0023', '0.0012']
    assert words == f'    {WORDS}'
    assert y1.index('1.5') == y2.index('-1.023') == titles.index('VALUE')


def test_colours_say_who_speaks():
    lines = screen(told(channel('y1'), served(), channel('y3', 'silent'), channel('y4', 'none'),
                        loop()), 0.1, '/replacer', 80, 24)
    assert {s: style_of(lines, s) for s in LEVELS} == {
        'real': 'green', 'virtual': 'yellow', 'none': 'bold red', 'silent': 'bright_black'}


def test_what_is_wrong_with_the_node_is_in_the_head():
    lines = show(loop(state='inactive', message='inactive; nothing goes out', overruns=7,
                      clock_stood_still=2))
    assert lines[0].startswith('/replacer inactive')
    assert lines[1].endswith(', 7 overruns')
    assert lines[2:] == ['    the clock jumped: stood still 2', '    inactive; nothing goes out']


def test_an_old_status_is_said_and_grey():
    lines = screen(told(served(), loop()), 5.2, '/replacer', 80, 24)
    assert text(lines)[0] == '/replacer SILENT since 5.2 s: is it running? ros2 node list'
    assert {style for line in lines[1:] for _, style in line} == {'bright_black'}
    assert 'SILENT' not in show(loop(), age=2.9)[0]


def test_ten_channels_in_trouble_fit_a_small_terminal():
    ten = [served(f'y{i}', message=f'{WORDS}; it is healthy again, returns after {i} s')
           for i in range(10)]
    lines = show(*ten, loop())
    assert sum('virtual ' in line and '-1.023' in line for line in lines) == 10
    assert all(f'returns after {i} s' in '\n'.join(lines) for i in range(10))


def test_more_channels_are_counted_and_the_worst_kept():
    many = [*(channel(f'r{i}') for i in range(30)), channel('s', 'silent', 'nothing comes'),
            served(), channel('n', 'none', NO_SOURCE)]
    lines = show(*many, loop())
    assert [line.split()[0] for line in lines[3:9:2]] == ['n', 's', 'y2']
    assert lines[-1] == 'and 16 more: 16 real' and len(lines) == 24
    lines = show(*many, loop(), height=7)
    assert lines[-1] == 'and 32 more: 1 silent, 1 virtual, 30 real'


@pytest.mark.parametrize('width', [1, 5, 20, 40, 60, 200])
@pytest.mark.parametrize('height', [1, 3, 8])
def test_any_terminal_will_do(width, height):
    lines = show(channel('left_front_wheel_velocity'), served(), channel('y4', 'none', NO_SOURCE),
                 loop(faulty='y2'), width=width, height=height)
    if (width, height) == (40, 8):
        assert any(line.startswith('left_fr..elocity real') for line in lines)
        assert any(line.endswith('repair y4') for line in lines)  # the remedy comes last


def test_what_comes_from_outside_cannot_steer_the_terminal():
    odd = DiagnosticStatus(name='y\x1b[2J', message='\n\x07', values=[
        KeyValue(key='value', value='much'), KeyValue(key='since_s', value=''),
        KeyValue(key='source', value='\x1b')])
    lines = show(odd, DiagnosticStatus(name='replacer'))
    assert all(line.isprintable() for line in lines) and 'y?[2J' in '\n'.join(lines)
    assert all(line.isprintable() for line in changes(None, told(odd)))


@pytest.mark.parametrize('seconds, written', [
    (0.04, '0.0 s'), (9.9, '9.9 s'), (35.2, '35 s'), (120.0, '2 min'), (7200.0, '2.0 h'),
    (259200.0, '3 d')])
def test_durations(seconds, written):
    assert duration(seconds) == written


def test_a_line_on_each_change_and_none_on_numbers():
    before = told(channel('y1'), channel('y2'), loop())
    assert len(changes(None, before)) == 3
    assert changes(before, told(channel('y1', value=7.0), channel('y2', since_s=9), loop(
        step_max=1.0, achieved=99.0))) == []
    after = told(channel('y1', fault_set='y2'), served(), loop(faulty='y2'))
    node, y2 = changes(before, after)
    assert node.startswith('replacer: active; faulty: y2; ')
    assert y2 == f'y2: virtual -1.023 +- 0.02 rad/s by {{y2,y3}} exact: {WORDS}'
    assert changes(after, told(channel('y1'), served(message=WORDS.replace('0.02', '0.03')),
                               loop(faulty='y2'))) == []
    for fact in ({'switches': 5}, {'fault_set': 'y2'}, {'grade': 'bounded'}):
        assert len(changes(after, told(channel('y1'), served(**fact), loop(faulty='y2')))) == 1
    assert changes(after, told(served(), loop(faulty='y2'))) == ['y1: not served any more']


# on the graph

@pytest.fixture
def replacer(monkeypatch):
    """Say a status once, before anybody listens; the domain is the monitor's, too."""
    monkeypatch.setattr(monitor, 'PATIENCE', 60.0)  # the machine may be busy
    with reserved_domain() as domain:
        monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node('replacer', namespace='/arm', context=context)
        publisher = node.create_publisher(DiagnosticArray, '~/status', QoSProfile(
            depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        publisher.publish(DiagnosticArray(status=[channel('y1'), served(), loop()]))
        yield publisher
        node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_status_is_heard_late(replacer, capsys):
    assert main(['--once', '--node', '/arm/replacer']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith('/arm/replacer active') and lines[4].startswith('y2      virtual')


def test_changes_are_printed_and_silence_and_all_again_after_it(replacer, monkeypatch):
    monkeypatch.setattr(monitor, 'OLD', 0.3)
    said = []

    def say(clock, line, flush):
        said.append(line.partition(':')[0].partition(' since')[0])
        if said.count('/arm/replacer SILENT') == 2:
            raise KeyboardInterrupt
        if said[-1] == '/arm/replacer SILENT':
            replacer.publish(DiagnosticArray(status=[served(), loop()]))
    monkeypatch.setattr(monitor, 'print', say, raising=False)
    assert main(['--plain', '--node', 'arm/replacer']) == 0
    assert said == ['replacer', 'y1', 'y2', '/arm/replacer SILENT', 'replacer', 'y2',
                    '/arm/replacer SILENT']


def test_on_a_terminal_it_is_drawn_until_interrupted(replacer):
    pytest.importorskip('rich')
    terminal, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack('HHHH', 24, 80, 0, 0))
    process = subprocess.Popen(
        [sys.executable, '-m', 'vsensor_ros.command.monitor', '--node', '/arm/replacer'],
        stdin=slave, stdout=slave, stderr=slave, env={**os.environ, 'TERM': 'xterm'},
        preexec_fn=die_with_parent)
    os.close(slave)
    drawn = b''
    while b'{y2,y3} exact' not in drawn:
        drawn += os.read(terminal, 65536)  # at the end of the process: OSError
    process.send_signal(signal.SIGINT)
    try:
        while more := os.read(terminal, 65536):
            drawn += more
    except OSError:
        pass
    assert process.wait(60.0) == 0
    os.close(terminal)
    assert b'\x1b[33mvirtual' in drawn and b'Traceback' not in drawn
    assert drawn.rstrip().endswith(b'\x1b[?1049l')  # what was on the screen before is back


def test_where_nothing_is_heard_it_says_why(replacer, capsys, monkeypatch):
    for patience in (0.5, 5.0, 30.0):  # a busy machine discovers the other one late
        monkeypatch.setattr(monitor, 'PATIENCE', patience)
        assert main(['--once']) == 1
        said = capsys.readouterr().err
        if '--node' in said:
            break
    assert said == (
        'monitor: no replacer on /replacer/status: is it running? ros2 node list; or is it --node '
        '/arm/replacer?\n')


@pytest.mark.parametrize('name', ['', '/', 'a b', '/1x', 'a//b'])
def test_a_bad_name_is_refused_in_one_line(name, capsys):
    assert main(['--once', '--node', name]) == 2
    said = capsys.readouterr().err
    assert said.startswith('monitor: --node: ') and said.count('\n') == 1


def test_without_rich_one_line_says_how_to_install_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'rich', None)
    assert not monitor._has_rich()
    assert 'apt install python3-rich' in capsys.readouterr().err
