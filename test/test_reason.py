"""Reasons are data; the sentences of a code stand once."""

import pytest

from vsensor_ros.reason import add_sentences, Reason, SENTENCES


def test_a_reason_is_its_code_and_facts():
    one = Reason.of('input silent', name='y1', seconds=1.0)
    assert one == Reason.of('input silent', name='y1', seconds=1.0) and len({one, one}) == 1
    assert one.fact('name') == 'y1' and str(one) == 'y1 silent for 1.0 s'
    assert str(Reason.of('force waits', why=one)) == 'force waits: y1 silent for 1.0 s'
    assert str(Reason.of('no design', failed=('y1', Reason.of(
        'named', name='y2', why=Reason('forced'))))) == (
            'no design for the loss of y1, y2 (forced)')


def test_what_comes_from_outside_is_no_pattern():
    assert str(Reason.of('refused', text='{0} {x!r} %s')) == '{0} {x!r} %s'


def test_a_code_that_nobody_has_a_sentence_for_is_shown_as_it_is():
    assert str(Reason.of('worn out', seconds=1.0)) == 'worn out'


def test_sentences_may_be_added_once(monkeypatch):
    monkeypatch.setattr('vsensor_ros.reason.SENTENCES', dict(SENTENCES))
    more = {'worn out': 'worn out after {seconds:.0f} s',
            'lost': lambda names: f'lost: {" or ".join(names)}'}
    add_sentences(more)
    add_sentences(more)  # the same once more does no harm
    assert str(Reason.of('worn out', seconds=1.0)) == 'worn out after 1 s'
    assert str(Reason.of('lost', names=('a', 'b'))) == 'lost: a or b'
    with pytest.raises(ValueError, match='isolated: there is a sentence for this code already'):
        add_sentences({'isolated': 'alone'})
