"""A plant file that is to be written back is read as carefully as any other."""

import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.fit import main

pytest.importorskip('ruamel.yaml')


@pytest.mark.parametrize(('text', 'needle'), [
    ('[' * 3000, 'nested too deeply'),
    ('name: &n servo\ndescription: *n\n', 'alias')])
def test_what_the_reader_refuses_is_one_line(tmp_path, capsys, text, needle):
    plant = tmp_path / 'plant.yaml'
    plant.write_text(text, encoding='utf-8')
    assert main([str(plant), str(tmp_path / 'table.csv'), '--try', 'friction', '-o',
                 str(tmp_path / 'fitted.yaml')]) == 2
    said = capsys.readouterr().err
    assert needle in said and str(plant) in said and len(said.splitlines()) == 1
    assert not (tmp_path / 'fitted.yaml').exists()


def test_a_tag_makes_no_object(tmp_path):
    from vsensor_ros.fitting.plant_text import open_text
    plant, made = tmp_path / 'plant.yaml', tmp_path / 'made'
    plant.write_text(f'name: !!python/object/apply:os.mkdir ["{made}"]\n', encoding='utf-8')
    with pytest.raises(BadInput):
        open_text(plant)
    assert not made.exists()
