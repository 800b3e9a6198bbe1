"""What the algebra of functions says, by code."""

from __future__ import annotations

from vsensor_ros.reason import add_sentences


def _many_valued(wanted: str, one: str, other: str) -> str:
    return (f'{wanted} has two values for the same readings within the declared ranges, as at '
            f'{one} and at {other}: narrow a range to where one of them cannot be; which of '
            'the two it is from what it was, nobody follows')


add_sentences({
    'functions none found': 'no function of the states that the unknown inputs do not reach tells '
    '{wanted} beside the healthy sensors: none among {count} products up to degree {degree}; that '
    'there is none is not proved',
    'functions impossible': 'no function of the states whatever tells {wanted}: the unknown '
    'inputs, and what follows from them, reach {dimension} of {states} directions, and one of '
    'these moves it and no healthy sensor',
    'functions not submersive': 'the next states do not fill the space of states ({rank} of '
    '{states} directions), so a function may pass every test and say nothing',
    'functions no output map': 'a function is there, but no expression for {wanted} was found',
    'functions no right side': 'a function is there ({phi}), but no expression for its change '
    'was found',
    'functions many-valued': _many_valued,
    'functions not stable': 'a function is there ({phi}), but an error of its observer may grow, '
    'at a rate of up to {growth:.3g}',
    'functions singular': '{part} must stay away from 0 (here {floor:.3g})',
    'functions root': '{part} must stay positive',
    'functions rank close': 'the rank is not clear at the points that were tried',
    'functions beyond dictionary': 'found within a dictionary only: there may be more',
    'functions independent': 'of rank {rank} at a random point, {more} with the other',
    'functions not smooth': '{function} is not smooth',
    'functions points': 'there is no point at which all is finite',
})
