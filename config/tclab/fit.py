"""
Fit the plant file of the temperature control lab to the first half of its recording.

    python config/tclab/fit.py RECORDING.mat -o config/tclab/plant.yaml

Two heaters on one board, each with its sensor: T1 and T2 lose heat to the surroundings and
exchange it with each other,

    dT1/dt = loss1*(ambient - T1) + exchange*(T2 - T1) + gain1*Q1
    dT2/dt = loss2*(ambient - T2) + exchange*(T1 - T2) + gain2*Q2

Nobody measured the ambient temperature, which stands for all that both channels share, and it
drifts: simulated from Q1 and Q2 alone, T1 is wrong by more than a degree. The fit takes it for a
random walk and maximises the likelihood of both sensors under a steady Kalman filter, which
yields the sensors' noise as well. The plant file names the ambient as a disturbance, so that
what is designed on it does not depend on it. The second half of the recording is only scored,
never fitted.
"""

import argparse
from pathlib import Path
import sys

import numpy as np
from scipy.io import loadmat
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import minimize
from scipy.signal import lfilter
import yaml

PARAMETERS = {
    'loss1': '1/s', 'loss2': '1/s', 'exchange': '1/s',
    'gain1': 'degC/(% s)', 'gain2': 'degC/(% s)'}
# Heat-up times of minutes, a drift of a degree in some minutes, noise of a few steps of 0.05 degC.
GUESS_PARAMETERS = [3e-3, 3e-3, 2e-3, 4e-3, 2.5e-3]
GUESS_DEVIATIONS = [0.01, 0.01, 0.03, 0.1, 0.2]  # of T1, T2, ambient a step; of the two sensors


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the readings (T1, T2) [degC] and the commands (Q1, Q2) [%], a row a second."""
    with path.open('rb') as file:
        data = loadmat(file, squeeze_me=True, struct_as_record=False)['data']
    y, u = np.asarray(data.ydat, float), np.asarray(data.udat, float)
    if not (y.shape == u.shape == (len(data.time), 2) and np.isfinite([y, u]).all()):
        raise ValueError('ydat and udat must have two columns of finite numbers, a row a sample')
    if not np.allclose(np.diff(data.time), 1.0):
        raise ValueError('the samples are not one second apart')
    return y, u


def continuous(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, D of the two temperatures; D belongs to the ambient temperature."""
    loss1, loss2, exchange, gain1, gain2 = parameters
    a = np.array([[-loss1 - exchange, exchange], [exchange, -loss2 - exchange]])
    return a, np.diag([gain1, gain2]), np.array([[loss1], [loss2]])


def discrete(parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the one-second transition of (T1, T2, ambient) and its input matrix."""
    a, b, d = continuous(parameters)
    step = expm(np.block([[a, d, b], [np.zeros((3, 5))]]))
    return step[:3, :3], step[:3, 3:]


def recur(transition: np.ndarray, forcing: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the rows x[0] = start, x[k+1] = transition x[k] + forcing[k], by modes for speed."""
    modes, vectors = np.linalg.eig(transition)
    driven = np.linalg.solve(vectors, np.column_stack([start, forcing[:-1].T]))
    rows = [lfilter([1.0], [1.0, -mode], row) for mode, row in zip(modes, driven)]
    return (vectors @ np.array(rows)).real.T


def predict(
    theta: np.ndarray, y: np.ndarray, u: np.ndarray, seen: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Return one-step predictions of (T1, T2) by the filter that reads `seen`, and S of those."""
    transition, inputs = discrete(np.exp(theta[:5]))
    variances = np.exp(2 * theta[5:10])
    c = np.eye(3)[list(seen)]
    q, r = np.diag(variances[:3]), np.diag(variances[3:][list(seen)])
    p = solve_discrete_are(transition.T, c.T, q, r)
    s = c @ p @ c.T + r
    gain = np.linalg.solve(s, c @ p @ transition.T).T
    forcing = u @ inputs.T + y[:, list(seen)] @ gain.T
    return recur(transition - gain @ c, forcing, theta[10:])[:, :2], s


def misfit(theta: np.ndarray, y: np.ndarray, u: np.ndarray) -> float:
    """Return the negative log-likelihood a sample, but for a constant."""
    predicted, s = predict(theta, y, u, (0, 1))
    error = y - predicted
    weighted = np.linalg.solve(s, error.T).T
    return float(np.linalg.slogdet(s)[1] + np.mean(np.sum(error * weighted, axis=1))) / 2


def fit(y: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return theta: log parameters (5), log deviations (5), T1, T2 and ambient at the start."""
    theta = np.r_[np.log(GUESS_PARAMETERS + GUESS_DEVIATIONS), y[0], y[0].mean()]
    while True:  # restart the quasi-Newton steps until they gain nothing
        found = minimize(misfit, theta, args=(y, u), method='L-BFGS-B')
        if found.fun > misfit(theta, y, u) - 1e-9:
            return found.x
        theta = found.x


def rebuild(parameters: np.ndarray, y: np.ndarray, u: np.ndarray, lost: int) -> np.ndarray:
    """
    Return temperature `lost` from Q1, Q2 and the other sensor, whatever the ambient does.

    z = T_lost - m T_other with m such that the ambient cancels: dz/dt = N z + J T_other + b u,
    readings linear between the samples, commands held; started from the first readings.
    """
    a, b, d = continuous(parameters)
    other = 1 - lost
    m = d[lost, 0] / d[other, 0]
    phi = np.zeros(2)
    phi[[lost, other]] = 1.0, -m
    n, j = (phi @ a)[lost], (phi @ a)[other] + m * (phi @ a)[lost]
    decay = np.exp(n)
    held, ramp = (decay - 1) / n, (decay - 1 - n) / n**2
    x = y[:, other]
    forcing = held * (u @ (phi @ b) + j * x)
    forcing[:-1] += ramp * j * np.diff(x)
    start = y[0, lost] - m * x[0]  # the recording starts healthy; forgotten within minutes
    return recur(np.array([[decay]]), forcing[:, None], np.array([start]))[:, 0] + m * x


def rmse(error: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def figures(theta: np.ndarray, y: np.ndarray, u: np.ndarray, half: int) -> dict[str, np.ndarray]:
    """Return, for each way to rebuild T1 without reading it, its error at every sample."""
    parameters = np.exp(theta[:5])
    transition, inputs = discrete(parameters)
    return {
        'virtual sensor (order 1)': rebuild(parameters, y, u, 0) - y[:, 0],
        'Kalman filter on T2 (order 3)': predict(theta, y, u, (1,))[0][:, 0] - y[:, 0],
        'simulation from Q1, Q2': recur(transition, u @ inputs.T, theta[10:])[:, 0] - y[:, 0],
        'last value held': y[half - 1, 0] - y[:, 0],
    }


def plant_file(theta: np.ndarray, comment: str) -> str:
    """Return the text of the plant file."""
    values = dict(zip(PARAMETERS, np.exp(theta[:5]).tolist()))
    noise, start = np.exp(theta[8:10]).tolist(), theta[10:12].tolist()
    plant = {
        'name': 'tclab',
        'description': 'Temperature control lab board, two heaters and two sensors, as deviations '
                       'from the mean of the recording; the ambient temperature is unknown.',
        'time': 'continuous',
        'parameters': {
            name: {'value': float(f'{values[name]:.5g}'), 'unit': unit}
            for name, unit in PARAMETERS.items()},
        'states': {
            name: {'unit': 'degC', 'initial': round(value, 2)}
            for name, value in zip(('T1', 'T2'), start)},
        'inputs': {name: {'unit': '%'} for name in ('Q1', 'Q2')},
        'disturbances': {'ambient': {'unit': 'degC'}},
        'dynamics': {
            'T1': 'loss1*(ambient - T1) + exchange*(T2 - T1) + gain1*Q1',
            'T2': 'loss2*(ambient - T2) + exchange*(T1 - T2) + gain2*Q2'},
        'sensors': {
            name: {'measures': name, 'unit': 'degC', 'noise': round(value, 3)}
            for name, value in zip(('T1', 'T2'), noise)},
    }
    body = ''.join(
        yaml.safe_dump(
            {key: value}, sort_keys=False, width=99,
            default_flow_style=None if isinstance(value, dict) and key != 'dynamics' else False)
        for key, value in plant.items())
    return ''.join(f'# {line}'.rstrip() + '\n' for line in comment.splitlines()) + body


def main() -> int:
    """Fit, write the plant file, print the figures of both halves."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('recording', type=Path, help='tclab_kuntz_rawlings_2022.mat')
    parser.add_argument('-o', '--output', type=Path, required=True, help='the plant file to write')
    options = parser.parse_args()
    try:
        y, u = read(options.recording)
    except (OSError, LookupError, AttributeError, TypeError, ValueError) as problem:
        print(f'{options.recording}: not the recording: {problem}', file=sys.stderr)
        return 2
    half = len(y) // 2
    theta = fit(y[:half], u[:half])
    innovations = (predict(theta, y[:half], u[:half], (0, 1))[0] - y[:half]).std(axis=0)
    errors = figures(theta, y, u, half)
    table = '\n'.join(
        f'  {name:<30} {rmse(error[:half]):7.3f} {rmse(error[half:]):8.3f}'
        for name, error in errors.items())
    comment = f"""\
Written by config/tclab/fit.py; do not edit, run it again.
Fitted to samples 0 to {half - 1} of {len(y)} of {options.recording.name}
(1 s; Kuntz and Rawlings 2022, github.com/rawlings-group/mlid_2024).
One-step residuals there: T1 {innovations[0]:.3f}, T2 {innovations[1]:.3f} degC.
RMSE of T1 without reading it [degC]: first half, unseen second half
{table}"""
    print(comment)
    try:
        options.output.write_text(plant_file(theta, comment), encoding='utf-8')
    except OSError as problem:
        print(f'{options.output}: cannot be written: {problem.strerror}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    sys.exit(main())
