"""The estimator of states and faults: its equalities, what it proves, and the twin rotor."""

from dataclasses import replace
import json
from pathlib import Path

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from benchmark.twin_rotor import form_of, moved, PLANT, simulate, table
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.fault_estimator import descriptor, estimator, least_T, quietest
from vsensor_ros.designer.quadratic_bound import Inequalities
from vsensor_ros.plant import load_takagi_sugeno, TakagiSugeno

REFERENCE = json.loads((Path(__file__).parents[1] / 'reference.json').read_text())['d_trms']
WEIGHTS = ['(1 - p)/2', '(1 + p)/2']


def form_with(seed, n=3):
    """Make a random stable plant of which all states are read; the last sensor may be faulty."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(n, n)) + 0.1 * random.normal(size=(2, n, n))
    A *= 0.9 / max(np.linalg.norm(one, 2) for one in A)
    B = random.normal(size=(2, n, 1))
    names = ['p', *(f'x{i}' for i in range(1, n))]
    plant = TakagiSugeno.of_submodels(
        A, B, np.eye(n), premises={'p': [-1, 1]}, memberships=WEIGHTS, states=names,
        sample_time=0.1)
    return descriptor(plant, B.mean(axis=0), [f'y{n}'], W1=0.02 * np.eye(n), W2=0.1 * np.eye(n))


def errors(form, found, w, h):
    """Return the errors (steps, N) of plant and estimator that run side by side."""
    plant, n = form.plant, form.plant.A.shape[1]
    random = np.random.default_rng(0)
    W1, W2 = 0.02 * np.eye(n), 0.1 * np.eye(n)
    x, before, z, off = np.zeros(n), np.zeros(1), np.zeros(form.size), []
    for k in range(len(w)):
        u, fa, fs = random.normal(size=(3, 1)) * 10
        true = np.concatenate([x, before, fs])
        y = form.Cb @ true + W2 @ w[k, n:]
        off.append(true - z - found.T2 @ y)
        z = sum(np.tensordot(h[k], many, 1) @ one for many, one in (
            (found.N, z), (found.M, u), (found.L, y)))
        x = np.tensordot(h[k], plant.A, 1) @ x + np.tensordot(h[k], plant.B, 1) @ u \
            + plant.B.mean(axis=0) @ fa + W1 @ w[k, :n]
        before = fa
    return np.array(off)


@settings(max_examples=5)
@given(st.integers(0, 1000))
def test_error_ignores_inputs_and_faults_and_never_leaves_its_interval(seed):
    pytest.importorskip('cvxpy')
    form = form_with(seed)
    found = estimator(form, [0.1])
    n = len(form.plant.states)
    assert abs(found.T1 @ form.E + found.T2 @ form.Cb - np.eye(form.size)).max() < 1e-9
    T = np.hstack([found.T1, found.T2])
    assert Inequalities(form.G, form.R, form.goal).norm(T, found.K, found.P, 0.1) < 1.0
    random = np.random.default_rng(seed)
    h = random.dirichlet([0.5, 0.5], 300)
    # w on its ellipsoid, turning with the error as badly as one submodel's largest direction
    worst = np.linalg.svd((T @ form.G[0] - found.K[0] @ form.R)[:, form.size:form.size + 2 * n])
    w = random.normal(size=(300, 2 * n))
    w[150:] = worst[2][0] * np.sign(np.sin((np.arange(150) + 0.5) / 5.0))[:, None]
    w *= np.sqrt(0.5) / np.linalg.norm(w, axis=1)[:, None]
    off = errors(form, found, w, h)[100:]  # the start is forgotten
    assert (np.einsum('ki,ij,kj->k', off, found.P, off) < 1.0).all()
    assert (abs(off) <= found.half_widths).all()
    w[:] = 0.0
    assert abs(errors(form, found, w, h)[-1]).max() < 1e-6  # whatever the faults are


def test_least_form_of_one_submodel_is_the_riccati_recursions():
    pytest.importorskip('cvxpy')
    form = form_with(3)
    form = replace(form, G=np.array([form.G.mean(axis=0)] * 2))
    least = np.sqrt(np.diag(quietest(form, 0.1)[1]))[form.goal]
    found = estimator(form, [0.1])
    assert found.half_widths[form.goal] == pytest.approx(least, rel=2e-3)
    assert (found.half_widths[form.goal] >= least * (1 - 1e-6)).all()
    easier = estimator(form, [0.1], fixed_gains=True)
    assert easier.half_widths[form.goal] >= found.half_widths[form.goal] * (1 - 1e-6)


def test_refusals_say_what_to_relax():
    plant = load_takagi_sugeno(PLANT)
    blind = replace(plant, C=plant.C[1:], sensors=plant.sensors[1:])
    form = descriptor(blind, plant.B.mean(axis=0), ['yaw_rate', 'pitch_rate'],
                      W1=0.01 * np.eye(6), W2=0.05 * np.eye(5))
    with pytest.raises(BadInput, match="a mode 1 per step of 'theta_h' is hidden.*give a sensor"):
        estimator(form, [0.02])
    with pytest.raises(BadInput, match='cannot be told apart with 6 sensors'):
        descriptor(plant, plant.B.mean(axis=0), list(plant.sensors)[:5], W1=np.eye(6),
                   W2=np.eye(6))


def test_an_indefinite_form_and_a_wrong_gain_are_not_believed():
    form = form_with(1)
    lmi = Inequalities(form.G, form.R, form.goal)
    T, S = quietest(form, 0.1)
    P = np.linalg.inv(S)
    K = lmi.gains(T, P, 0.1)
    assert lmi.norm(T, K, P, 0.1) < 1.5
    assert lmi.norm(T, K, P - 2 * np.linalg.eigvalsh(P)[-1] * np.eye(len(P)), 0.1) == np.inf
    assert lmi.norm(T, K + 30.0, P, 0.1) > 10.0


def test_twin_rotor_is_as_printed_and_its_machine_is_that_of_the_submodels():
    plant = load_takagi_sugeno(PLANT)
    for i in range(16):
        assert plant.A[i] == pytest.approx(np.array(REFERENCE['A'][str(i + 1)]), abs=1e-9)
        assert plant.B[i] == pytest.approx(np.array(REFERENCE['B'][str(i + 1)]), abs=1e-9)
    random = np.random.default_rng(2)
    x = random.uniform(-1, 1, (6, 30)) * np.array([[1, 1, 150, 0.5, 1, 150]]).T
    u = random.uniform(-0.5, 0.5, (2, 30))
    ahead = plant.rate_of_change(x, u, np.zeros((0, 30)))
    true = np.array([moved(*pair) for pair in zip(x.T, u.T)]).T
    # five digits are printed, and pitch moves within a sample
    assert abs(ahead - true).max(axis=1) == pytest.approx(0, abs=3e-3)


@pytest.mark.slow
def test_twin_rotor_reaches_the_figures_of_the_method():
    pytest.importorskip('cvxpy')
    plant = load_takagi_sugeno(PLANT)
    unit = np.array([1, 1, 100, 1, 1, 100])  # in which the reference's T is the smallest
    scaled = replace(plant, A=plant.A * unit / unit[:, None], B=plant.B / unit[:, None])
    form = descriptor(scaled, 0.1 * scaled.B.mean(axis=0), ['yaw_rate', 'pitch_rate'],
                      W1=np.diag(0.01 / unit), W2=np.diag(0.05 / unit))
    T = least_T(form)
    found = Inequalities(form.G, form.R, form.goal).solve(0.005, T, quietest(form, 0.005, T)[1])
    reference = REFERENCE['lmi']['reduced']
    assert found.norm <= 1.0
    assert np.sqrt(np.diag(np.linalg.inv(found.P)))[-2:] == pytest.approx(
        reference['half'][-2:], rel=2e-3)
    N = (found.T @ form.G - found.K @ form.R)[:, :, :10]
    assert abs(np.linalg.eigvals(N)).max() == pytest.approx(reference['rho_max'], abs=1e-4)


def test_no_linear_filter_is_as_quiet_as_the_easier_way_was_once_said_to_be():
    """Even one that knows the noise, and which submodel is true: see docs/twin_rotor.md."""
    form = form_of(load_takagi_sugeno(PLANT))
    sigma = np.sqrt(0.5 / (12 + 2))  # uniform in a ball of twelve dimensions, of radius sqrt(1/2)
    for vertex in (0, 2, 4, 8):
        S = quietest(replace(form, G=form.G[[vertex]]))[1]
        yaw, pitch = sigma * np.sqrt(np.diag(S)[form.goal])
        assert 0.0173 < yaw < 0.01733 and 0.0181 < pitch < 0.0183


@pytest.mark.slow
def test_intervals_of_the_twin_rotor_contain_the_machine():
    pytest.importorskip('cvxpy')
    plant = load_takagi_sugeno(PLANT)
    found = estimator(form_of(plant), [0.012])
    assert (found.half_widths[-2:] < [1.2, 1.3]).all()
    run = simulate(plant, found)
    off = run.estimates - run.truth
    assert (abs(off) <= found.half_widths).all()
    assert (np.sqrt(np.mean(off**2, axis=0))[-2:] < [0.025, 0.025]).all()
    assert len(table(found, run)) == 11
