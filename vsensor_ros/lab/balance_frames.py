"""
Frames of a machine in MuJoCo, rendered without a display; run as a process of its own.

OpenGL without a display is not on every computer, and where it is broken it may take its process
with it. So it gets one that may die, and there are no frames then.
"""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import subprocess
import sys
import tempfile

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.lab.process import die_with_parent, ROOT

PATIENCE = 60.0     # s
LOW = -6.0          # degrees from which the camera looks down


def render(model: Path, poses: Sequence[Sequence[float]], centres: Sequence[float], span: float,
           shape: tuple[int, int]) -> NDArray[np.uint8] | None:
    """
    Return a picture (n, height, width, 3) of each pose, or None where there is no OpenGL.

    poses: of all joints. centres: where the camera looks [m]. span: how wide it sees [m].
    """
    with tempfile.TemporaryDirectory() as folder:
        order, found = Path(folder, 'order.npz'), Path(folder, 'frames.npy')
        np.savez(order, poses=np.array(poses), centres=np.array(centres), span=span,
                 shape=np.array(shape))
        environment = {'MUJOCO_GL': 'egl', **os.environ,
                       'PYTHONPATH': os.pathsep.join([str(ROOT), *filter(None, [
                           os.environ.get('PYTHONPATH')])])}
        try:
            subprocess.run([sys.executable, '-m', __name__, str(model), str(order), str(found)],
                           env=environment, stdin=subprocess.DEVNULL, capture_output=True,
                           timeout=PATIENCE, check=True, preexec_fn=die_with_parent)
            frames: NDArray[np.uint8] = np.load(found, allow_pickle=False)
        except (OSError, subprocess.SubprocessError):
            return None
    return frames


def _render(model_file: Path, order: Path, found: Path) -> None:
    import mujoco
    model = mujoco.MjModel.from_xml_path(str(model_file))
    data = mujoco.MjData(model)
    with np.load(order, allow_pickle=False) as asked:
        poses, centres, span = asked['poses'], asked['centres'], float(asked['span'])
        height, width = map(int, asked['shape'])
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = 90.0, LOW
    half = np.tan(np.radians(model.vis.global_.fovy) / 2.0)     # of what it sees, at 1 m
    camera.distance = span * height / width / (2.0 * half)
    frames = np.zeros((len(poses), height, width, 3), np.uint8)
    renderer = mujoco.Renderer(model, height, width)
    for frame, pose, centre in zip(frames, poses, centres):
        data.qpos[:] = pose
        mujoco.mj_forward(model, data)
        camera.lookat[:] = centre, 0.0, 0.22
        renderer.update_scene(data, camera)
        frame[:] = renderer.render()
    np.save(found, frames)
    renderer.close()


if __name__ == '__main__':
    _render(*map(Path, sys.argv[1:]))
