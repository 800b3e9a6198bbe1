"""What is written to a design file comes back to the last bit."""


from dataclasses import replace

from design_example import example
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np

from vsensor_ros import Design
from vsensor_ros.observers import (
    Certificate,
    Limit,
    Noise,
    OrderStep,
    Proof,
    Refusal,
    Rung,
)


def test_what_is_loaded_is_what_was_saved_to_the_last_digit(written):
    saved, loaded = example(), Design.load(written)
    for name in ('plant_name', 'plant_hash', 'states', 'inputs', 'sensors', 'units',
                 'sample_time', 'fault_sets', 'wanted', 'tolerances', 'ranges', 'wrap', 'curves',
                 'delays'):
        assert getattr(loaded, name) == getattr(saved, name)
    bits(loaded.Cu, saved.Cu)
    assert not loaded.Cu.flags.writeable and not saved.Cu.flags.writeable
    assert list(loaded.entries) == list(saved.entries)
    for key, entry in saved.entries.items():
        other = loaded.entries[key]
        same(other, entry)


def same(other, entry):
    """Check that two entries are equal, bit by bit."""
    assert frozen(entry) == frozen(other) and type(other) is type(entry)
    if isinstance(entry, Refusal):
        assert other == entry
        return
    for name, value in vars(entry).items():
        if isinstance(value, np.ndarray):
            bits(getattr(other, name), value)
        elif name not in ('Gz', 'Gy', 'Gu', 'terms', 'certificate', 'tracking'):
            assert getattr(other, name) == value
    for mine, theirs in zip((*entry.Gz, *entry.Gy, *entry.Gu), (*other.Gz, *other.Gy, *other.Gu)):
        bits(theirs, mine)
    assert [(t.name, t.text, t.slope.tolist()) for t in other.terms] == [
        (t.name, t.text, t.slope.tolist()) for t in entry.terms]
    for name, value in (vars(entry.tracking) if entry.tracking else {}).items():
        if isinstance(value, np.ndarray):
            bits(getattr(other.tracking, name), value)
        else:
            assert getattr(other.tracking, name) == value
    if entry.certificate is not None:
        bits(other.certificate.S, entry.certificate.S)
        assert {**vars(other.certificate), 'S': 0} == {**vars(entry.certificate), 'S': 0}


def bits(theirs, mine):
    assert theirs.shape == mine.shape and theirs.tobytes() == mine.tobytes()


def frozen(entry):
    """Check that no array can be written to; return how many there are."""
    arrays = [a for value in vars(entry).values()
              for a in (value if isinstance(value, tuple) else (value,))
              if isinstance(a, np.ndarray)]
    arrays += [term.slope for term in getattr(entry, 'terms', ())]
    tracking = getattr(entry, 'tracking', None)
    arrays += [a for a in vars(tracking).values() if isinstance(a, np.ndarray)] if tracking else []
    arrays += [entry.certificate.S] if getattr(entry, 'certificate', None) else []
    assert not any(array.flags.writeable for array in arrays)
    return len(arrays)


def test_numbers_of_numpy_are_written_as_what_they_are(tmp_path):
    result = example()
    key = ('y2',), 'y2'
    result.entries[key] = replace(
        result[key], noise=Noise(np.float64(0.1), np.float64(0.2), np.bool_(True)),
        proof=Proof(np.int64(0), np.int64(1), (), ()))
    result.save(tmp_path / 'x.json')
    loaded = Design.load(tmp_path / 'x.json')[key]
    assert (loaded.noise, loaded.proof) == (Noise(0.1, 0.2, True), Proof(0, 1, (), ()))
    assert loaded.noise.assumed is True and type(loaded.proof.upper) is int


_sizes = st.floats(0.0, allow_nan=False, allow_infinity=False)
_open = st.floats(0.0, allow_nan=False)
_numbers = st.floats(allow_nan=False, allow_infinity=False)
_text = st.text(st.characters(categories=('L', 'N', 'P', 'S')), max_size=8)
_certificates = st.one_of(
    st.builds(Certificate, st.just('none'), st.just(0.0), _open,
              arrays(float, (1, 1), elements=_numbers), st.just(()),
              st.none() | st.tuples(_open, _open), _text),
    st.builds(Certificate, st.just('region'), _open, _open,
              arrays(float, (1, 1), elements=st.floats(1e-300, 1e300)),
              st.lists(st.builds(Limit, st.none() | st.just(0), st.just(0),
                                 st.floats(max_value=0.0, allow_nan=False),
                                 st.floats(0.0, exclude_min=True, allow_nan=False)),
                       min_size=1, max_size=2, unique_by=lambda limit: limit.term).map(tuple),
              st.tuples(_open, _open), _text))


@settings(deadline=None, max_examples=40)
@given(proof=st.builds(
           Proof, st.just(1), st.just(1), st.tuples(
               st.builds(OrderStep, st.just(0), st.sampled_from(['impossible', 'open']), _text,
                         st.just(0), st.tuples(_sizes, _open)),
               st.builds(OrderStep, st.just(1), st.sampled_from(['possible', 'open']), _text,
                         st.integers(0, 5), st.tuples(_sizes, _open))),
           st.lists(_text, max_size=2).map(tuple)) | st.none(),
       ladder=st.lists(st.builds(Rung, st.integers(0, 99), _sizes, _sizes, _open, _text),
                       max_size=3).map(tuple),
       noise=st.none() | st.builds(Noise, _sizes, _open, st.booleans()),
       certificate=st.none() | _certificates, grade=st.sampled_from(['exact', 'bounded']),
       disturbance_gain=_sizes, Qu=arrays(float, (1, 1), elements=_numbers),
       Gu=st.tuples(arrays(float, (1, 1), elements=_numbers)))
def test_whatever_is_known_comes_back_to_the_last_bit(tmp_path_factory, **known):
    path = tmp_path_factory.getbasetemp() / 'round_trip.json'
    result = example()
    key = ('y2',), 'y2'
    result.entries[key] = replace(result[key], **known)
    result.save(path)
    same(Design.load(path)[key], result[key])


