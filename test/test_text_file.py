"""A text file is read whole, or one line says what is wrong with it, and where."""

import os

import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.observers.checked_json import read_json
from vsensor_ros.plant import load_plant
from vsensor_ros.simulate.section import Section
from vsensor_ros.simulate.table import read_table
from vsensor_ros.text_file import read_text

READERS = [load_plant, read_json, read_table, read_parameters, Section.of]


def read(path, largest=100):
    return read_text(path, 'file', 'name a file', largest)


def refusal(path, **options):
    with pytest.raises(BadInput) as raised:
        read(path, **options)
    assert '\n' not in str(raised.value)
    return str(raised.value)


def test_what_is_text(tmp_path):
    path = tmp_path / 'a.txt'
    for text in ('', 'a\tb\r\n', 'Temperatur in °C\n', '\U0001f916'):
        path.write_bytes(text.encode())
        assert read(path) == text
    path.write_bytes(b'\xef\xbb\xbfa')  # as Notepad saves it
    assert read(path) == 'a'
    assert read(path, 4) == 'a'
    assert 'file: is larger than 0 MiB; name a file' in refusal(path, largest=3)


@pytest.mark.parametrize('data, told', [
    (b'# Temperatur in \xb0C\n', "is not UTF-8: line 1, byte 0xb0 after '# Temperatur in '; save"),
    (b'a: 1\nb: \xe9\n', "line 2, byte 0xe9 after 'b: '"),
    ('°C: °\n'.encode() + b'\xb0', 'line 2, byte 0xb0;'),
    (b'\xef\xbb\xbf\n\xff', 'line 2, byte 0xff;'),
    (b'a' * 30 + b'\xc3', f"byte 0xc3 after '{20 * 'a'}'"),
    (b'a\nb\0', "is not a text file: line 2, character 0x00 after 'b'; name a file"),
    (b'\x1b[1m', 'is not a text file: line 1, character 0x1b;'),
])
def test_where_it_is_no_text(tmp_path, data, told):
    path = tmp_path / 'a.txt'
    path.write_bytes(data)
    assert f'{path}: file: ' in refusal(path) and told in refusal(path)


@pytest.mark.parametrize('reader', READERS, ids=lambda reader: reader.__qualname__)
def test_every_reader_names_the_byte(tmp_path, reader):
    path = tmp_path / 'latin'
    path.write_bytes(b'\n# in \xb0C\n')
    with pytest.raises(BadInput, match=r"latin: .*is not UTF-8: line 2, byte 0xb0 after '# in '"):
        reader(path)


def test_a_relative_path_says_where_it_begins(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    here = f'; relative paths begin in the working directory, {tmp_path}'
    assert f'a.txt: file: cannot be read (No such file or directory){here};' in refusal('a.txt')
    assert refusal('~/a.txt').endswith(
        f'{here}, and ~ is not the home directory here; name a file')
    assert 'relative' not in refusal('/no/such.txt')
    os.mkdir('gone')
    os.chdir('gone')
    os.rmdir(tmp_path / 'gone')
    assert 'which is gone' in refusal('a.txt')
    os.chdir(tmp_path)
