"""What is said of closed loops: the first line, the blocks, the table and the pictures."""

from pathlib import Path
import re

import pytest

from vsensor_ros import closed_loop, Controller, design, load_controller, load_plant
from vsensor_ros.command.designer import main
from vsensor_ros.report import loop_text
from vsensor_ros.report.design_answer import answer

CONFIG = Path(__file__).parents[2] / 'config'
CART_POLE = CONFIG / 'cart_pole'


@pytest.fixture(scope='module')
def cart():
    return load_plant(CART_POLE / 'plant.yaml')


@pytest.fixture(scope='module')
def carts(cart):
    """Return the design of the cart-pole."""
    return design(cart, [('angle', 'rate'), ('angle',), ('position',)])


def one_line(text):
    return ' '.join(text.split())


def test_the_first_line_says_that_the_loop_is_unstable(tmp_path, capsys):
    out, page = tmp_path / 'design.json', tmp_path / 'report.html'
    assert main([str(CART_POLE / 'plant.yaml'), '-o', str(out), '--fault-set', 'angle,rate',
                 '--controller', str(CART_POLE / 'controller.yaml'), '--uncertainty',
                 'pole=10%,drag=10%', '--report', str(page)]) == 0
    said, wrong = capsys.readouterr()
    assert not wrong
    first = said.splitlines()[0]
    assert first.startswith('IN THE LOOP UNSTABLE with angle+rate replaced, where the parameters '
                            'are off by 10 %: ')
    assert re.search(r'it grows by [0-9.]+ 1/s \(from [0-9.]+ % on\); certificates and '
                     "eigenvalues of N are the observer's, not the loop's", one_line(said))
    assert 'certified everywhere' in said and 'can be replaced' in said  # and yet
    assert 'all sensors healthy: stable\n' in said
    assert re.search(r'at the corners +[0-9] of 4 unstable, from [0-9.]+ % on; the worst grows by',
                     one_line(said))
    assert 'zero-order hold' in one_line(said)
    html = page.read_text()
    assert html.index('IN THE LOOP UNSTABLE') < html.index('can be replaced')
    assert '<h2>In the loop</h2>' in html and html.count('limit of stability') == 2
    assert 'at the corners' in html and '<script' not in html


def test_each_verdict_has_its_line(cart, carts):
    more = {'reads': cart.sensors, 'writes': cart.inputs}
    gain = Controller.gain([[-50.0, -34.2, -113.1, -21.6]], **more)
    lines = loop_text.headlines(closed_loop(cart, carts, gain))
    assert lines[0] == ('In the loop good for a time only with position replaced: the loop has a '
                        'mode that no reading holds')
    assert lines[1].startswith('In the loop HARDLY STABLE with angle+rate replaced: sensitivity '
                               'peak 81.9, so that a model that is wrong by 1.22 % may end it; ')
    well = design(cart, [('angle',)])
    [line] = loop_text.headlines(closed_loop(cart, well, gain, 'cart=5%,pole=3%'))
    assert line == ('In the loop stable with all sensors healthy and with angle replaced, also at '
                    '4 corners of parameters off as far as given; sensitivity peak 1.7 at most')
    [line] = loop_text.headlines(closed_loop(cart, well, gain))
    assert ', with the parameters as they are; sensitivity' in line
    [line] = loop_text.headlines(closed_loop(cart, well, Controller.gain(
        [[0.0, 0.0, 0.0, 0.0]], **more)))
    assert line.startswith('IN THE LOOP UNSTABLE with all sensors healthy and with angle '
                           'replaced: it grows by 5.11 1/s; ')
    # the angle is held, and nobody asks where the cart is
    loop = closed_loop(cart, well, Controller.gain([[0.0, 0.0, -60.0, -12.0]], **more))
    if loop.healthy.verdict == 'stays':
        [line] = loop_text.headlines(loop)
        assert 'a mode neither dies out nor grows with all sensors healthy' in line
        assert 'in position' in answer(well, None, None, cart, (), loop)


def test_what_is_to_be_known_besides(cart, carts):
    more = {'reads': cart.sensors, 'writes': cart.inputs}
    K = [[-50.0, -34.2, -113.1, -21.6]]
    [said] = loop_text.notes(closed_loop(cart, carts, Controller.gain(K, **more)))
    assert said.startswith('While the model is right the poles are those with healthy sensors')
    [said] = loop_text.notes(closed_loop(cart, carts, Controller.gain(
        K, **more, unheard=('force',))))
    assert said.endswith('while the model is right: the virtual sensors do not hear force.')
    servo = load_plant(CONFIG / 'servo' / 'plant.yaml')
    notes = loop_text.notes(closed_loop(servo, design(servo, [('y2',)]), load_controller(
        CONFIG / 'servo' / 'controller.yaml', servo)))
    assert ('Left out, because it has no slope at the operating point: sign(velocity).' in notes
            and 'The noise of the commands is made of noise that is assumed.' in notes)


def test_what_a_temporary_one_leaves_is_said_in_its_block(cart, carts):
    loop = closed_loop(cart, carts, load_controller(CART_POLE / 'controller.yaml', cart))
    said = answer(carts, set(), None, cart, (), loop)
    assert ('    position replaced: for a time only: the loop has a mode that no reading holds, '
            'in position\n' in said)
    assert 'what no reading holds stays; the rest dies out at ' in one_line(said)
    assert 'angle replaced: stable' not in said  # blocks that hold are not asked for


@pytest.mark.parametrize(('arguments', 'needle'), [
    (['--uncertainty', '10%'], '--uncertainty: stands there without a controller'),
    (['--controller', '{plant}'], "plant.yaml: unknown key 'time'"),
    (['--controller', '{none}'], 'none.yaml: cannot be read'),
    (['--controller', ''], '--controller: is empty'),
    (['--controller', '{K}', '--uncertainty', 'k9=1%'], "uncertainty: unknown parameter 'k9'"),
    (['--controller', '{K}', '--report', '{K}'], 'is the controller file itself'),
])
def test_what_is_wrong_is_one_line(tmp_path, capsys, arguments, needle):
    places = {'plant': CONFIG / 'servo' / 'plant.yaml', 'none': tmp_path / 'none.yaml',
              'K': CONFIG / 'servo' / 'controller.yaml'}
    assert main([str(places['plant']), '-o', str(tmp_path / 'x'), '--fault-set', 'y3',
                 *(a.format(**places) for a in arguments)]) == 2
    said, wrong = capsys.readouterr()
    assert not said and needle in wrong and wrong.count('\n') == 1


def test_the_example_of_the_docs(tmp_path, capsys, monkeypatch):
    page = (CONFIG.parent / 'docs' / 'in_the_loop.md').read_text()
    asked = re.search(r'    designer (.*?)\n\n', page, re.DOTALL)[1].replace('\\\n', ' ').split()
    monkeypatch.chdir(CONFIG.parent)
    assert main([str(tmp_path / 'x') if name.endswith('.json') else name for name in asked]) == 0
    said = capsys.readouterr().out
    block = page[page.index('```\nIN THE LOOP') + 4:]
    assert said.startswith(block[:block.index('```')])
