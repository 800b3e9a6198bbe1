"""Install vsensor_ros, by `colcon build` and by `pip install` alike (what is fixed: setup.cfg)."""

from pathlib import Path

from setuptools import find_packages, setup

package_name = 'vsensor_ros'
share = f'share/{package_name}'


def files_below(folder: str) -> list[tuple[str, list[str]]]:
    """Return (destination below share, files) for each folder of `folder`."""
    folders = [Path(folder), *sorted(p for p in Path(folder).rglob('*') if p.is_dir())]
    pairs = [
        (f'{share}/{f.as_posix()}',
         sorted(p.as_posix() for p in f.iterdir() if p.is_file() and p.suffix != '.pyc'))
        for f in folders if f.name != '__pycache__'
    ]
    return [(destination, files) for destination, files in pairs if files]


setup(
    name=package_name,
    version='0.1.0',
    python_requires='>=3.10',  # from setup.cfg it would be an object, which colcon cannot read
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (share, ['package.xml']),
        *files_below('config'),
        *files_below('launch'),
        # `ros2 run` looks here. pip would put entry points into bin/ only, whatever setup.cfg
        # says, so that what both installers have in common is a file copied to its place.
        (f'lib/{package_name}', [f'scripts/{name}' for name in (
            'align', 'check', 'demo', 'designer', 'fault_injection', 'fit', 'isolator', 'monitor',
            'player', 'recording', 'replacer', 'replay', 'start', 'wire')]),
    ],
    # On the PATH, where a bare `designer` would collide with anybody's.
    entry_points={
        'console_scripts': [
            f'vsensor_designer = {package_name}.command.designer:main',
            f'vsensor_replacer = {package_name}.command.replacer:main',
        ],
    },
)
