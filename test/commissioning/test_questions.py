"""What is asked, what is offered, and what an answer leaves to the others."""

import io

import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.commissioning.ranking import Candidate, Wanted
from vsensor_ros.commissioning.wire import ask, choose

TANKS = [Candidate(topic, 'std_msgs/msg/Float64', 'data', heard=9, found=9)
         for topic in ('/north/level', '/south/level', '/north/temperature')]
LEVELS = [Wanted('h1', False, 'm', ('level',)), Wanted('h2', False, 'm', ('level',))]


def script(asked, *topics):
    """Return who answers with these topics in turn, and keeps what was offered."""
    left = list(topics)

    def answer(choice):
        offered = [p for p in (choice.proposal, *choice.others) if p is not None]
        asked[choice.wanted.name] = [p.candidate.topic for p in offered]
        topic = left.pop(0)
        return next((p for p in offered if p.candidate.topic == topic), None)
    return answer


def chosen(choices):
    return {c.wanted.name: c.proposal and c.proposal.candidate.topic for c in choices}


def test_an_answer_sets_free_what_was_meant_for_it():
    asked = {}
    choices = choose(LEVELS, TANKS, script(asked, '/south/level'))
    assert asked == {'h1': ['/north/level', '/south/level', '/north/temperature']}
    assert chosen(choices) == {'h1': '/south/level', 'h2': '/north/level'}
    assert all(c.sure for c in choices)


def test_all_is_offered_that_no_answer_has():
    asked = {}
    three = [*LEVELS, Wanted('h3', False, 'm', ('level',))]
    tanks = [*TANKS, Candidate('/west/level', 'std_msgs/msg/Float64', 'data', heard=9, found=9)]
    choices = choose(three, tanks, script(asked, '/north/level', '/west/level'))
    assert asked['h2'] == ['/south/level', '/west/level', '/north/temperature']
    assert chosen(choices) == {'h1': '/north/level', 'h2': '/west/level', 'h3': '/south/level'}


def test_an_answer_may_take_what_was_sure_for_another():
    asked = {}
    wanted = [Wanted('y', False, 'm'), Wanted('north_level', False, 'm')]
    choices = choose(wanted, TANKS[:2], script(asked, '/north/level', '/south/level'))
    assert chosen(choices) == {'y': '/north/level', 'north_level': '/south/level'}
    assert asked == {'y': ['/north/level', '/south/level'], 'north_level': ['/south/level']}


def test_none_of_these_is_an_answer():
    choices = choose(LEVELS[:1], TANKS, script({}, 'none'))
    assert chosen(choices) == {'h1': None}


def test_answers_come_from_a_pipe_until_its_end(monkeypatch, capsys):
    monkeypatch.setattr('sys.stdin', io.StringIO('x\n2\n'))
    assert chosen(choose(LEVELS, TANKS, ask)) == {'h1': '/south/level', 'h2': '/north/level'}
    assert 'a number from 0 to 3' in capsys.readouterr().out
    monkeypatch.setattr('sys.stdin', io.StringIO(''))
    with pytest.raises(BadInput, match='^h1: it is not sure which sensor it is, and nobody can'):
        choose(LEVELS, TANKS, ask)


def test_all_that_agrees_is_offered(monkeypatch):
    many = [Candidate('/levels', 'a/msg/B', f'level[{i}]', heard=9, found=9) for i in range(40)]
    monkeypatch.setattr('sys.stdin', io.StringIO('33\n'))
    choice, = choose(LEVELS[:1], many, ask)
    assert choice.proposal.candidate.field == 'level[32]'


def test_what_does_not_agree_is_offered_and_not_taken(monkeypatch, capsys):
    heat = [Wanted('Q', True, 'W')]
    assert chosen(choose(heat, TANKS, None)) == {'Q': None}
    monkeypatch.setattr('sys.stdin', io.StringIO('\n'))
    assert chosen(choose(heat, TANKS, ask)) == {'Q': None}
    assert '(nothing speaks for it)' in capsys.readouterr().out
    monkeypatch.setattr('sys.stdin', io.StringIO('3\n'))
    assert chosen(choose(heat, TANKS, ask)) == {'Q': '/south/level'}
