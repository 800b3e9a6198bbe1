"""Design files of older versions: what they say is read, what they do not say is not claimed."""

from dataclasses import replace
import json
from pathlib import Path

from design_example import as_version_3, certificate, example, rewrite
import numpy as np
import pytest

from vsensor_ros import Design
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import Limit


def test_a_file_of_version_2_is_read_and_nothing_is_known_of_its_starts(written):
    def older(record):
        as_version_3(record)
        record.update(version=2)
        for key in ('wrap', 'Cu', 'curves', 'delays'):
            del record['plant'][key]
        del record['entries'][2]['start']
    rewrite(written, older)
    read = Design.load(written)
    assert read.Cu is None and all(v.start is None for v in read.virtual_sensors)
    assert len(read.entries) == len(example().entries)


def test_a_file_of_version_3_is_the_same_design(tmp_path):
    """Written by the designer, of config/three_tank, before there were kinds."""
    golden = Path(__file__).with_name('three_tank.version_3.json')
    record, loaded = json.loads(golden.read_text()), Design.load(golden)
    assert record['version'] == 3
    loaded.save(tmp_path / 'new.json')
    for read in (loaded, Design.load(tmp_path / 'new.json')):
        assert read.plant_hash == record['plant']['hash'] and len(read.entries) == 2
        for entry in record['entries']:
            v = read[entry['fault_set'], entry['channel']]
            assert v.kind == 'functional' and v.outputs == (v.channel,)
            for key in ('Phi', 'N', 'J', 'B', 'P', 'Cv', 'Q', 'Qu', 'z0', 'z0_gain', 'start'):
                assert getattr(v, key).tolist() == entry[key]
            for key in ('order', 'method', 'grade', 'noise_gain', 'disturbance_gain'):
                assert getattr(v, key) == entry[key]
            for term, text, gz, gy, gu in zip(entry['terms'], v.terms, v.Gz, v.Gy, v.Gu):
                assert [term['name'], term['function'], term['Gz'], term['Gy'], term['Gu']] == [
                    text.name, text.text, gz.tolist(), gy.tolist(), gu.tolist()]
            # the region is of the arguments that its texts name
            assert v.certificate.status == 'region' and len(v.certificate.region) == 2
            assert v.region == tuple((limit['name'], limit['low'], limit['high'])
                                     for limit in entry['certificate']['region'])
            assert [loaded[v.fault_set, v.channel].terms[limit.term].name
                    for limit in v.certificate.region] == [
                        f"sqrt({limit['name']})" for limit in entry['certificate']['region']]


def test_an_old_region_lists_equal_arguments_once_and_then_commands(tmp_path):
    golden = Path(__file__).with_name('three_tank.version_3.json')
    record = json.loads(golden.read_text())
    entry = record['entries'][0]
    entry['terms'].append({**entry['terms'][1], 'name': 'once more'})
    entry['P'] = [[*row, row[1]] for row in entry['P']]
    entry['certificate']['region'].append({'name': 'u2', 'low': None, 'high': 2.0})
    path = tmp_path / 'old.json'
    path.write_text(json.dumps(record))
    v = Design.load(path)['y1', 'y1']
    assert [limit[:2] for limit in v.certificate.region] == [(0, 0), (1, 0), (None, 1)]
    assert v.region[2] == ('u2', -np.inf, 2.0)


def test_a_region_of_an_older_file_that_nobody_can_place_is_no_proof(tmp_path):
    path = tmp_path / 'old.json'
    example().save(path)
    record = json.loads(path.read_text())
    as_version_3(record)
    certificate(record, 2)['region'].append({'name': 'x7', 'low': 0.0, 'high': 1.0})
    path.write_text(json.dumps(record))
    loaded = list(Design.load(path).entries.values())[2]
    assert loaded.certificate.status == 'none' and not loaded.certificate.region
    assert loaded.certificate.rate == 0.0 and 'older file' in loaded.certificate.reason


@pytest.mark.parametrize('scale', [1e-10, 1.0, 1e10])
def test_small_numbers_are_told_apart_in_an_older_region(tmp_path, scale):
    """Arguments in pascals have coefficients of any size."""
    path = tmp_path / 'old.json'
    made = example()
    key = ('y2',), 'y2'
    v = made[key]
    term = NonlinearTerm('sqrt(a)', v.terms[0].text, v.terms[0].slope)
    twice = replace(
        v, terms=(*v.terms, term), P=np.hstack([v.P, v.P]),
        Gz=(v.Gz[0] * scale, v.Gz[0] * 2.0 * scale), Gy=(v.Gy[0] * scale, v.Gy[0] * 2.0 * scale),
        Gu=(v.Gu[0], v.Gu[0]), certificate=replace(
            v.certificate, status='region',
            region=(Limit(0, 0, -1.0, 1.0), Limit(1, 0, -2.0, 2.0))))
    made.entries[key] = twice
    made.save(path)
    record = json.loads(path.read_text())
    as_version_3(record)
    path.write_text(json.dumps(record))
    assert Design.load(path)[key].certificate.region == twice.certificate.region


