"""The kernels of the particles against independent calculations with numpy."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.trackers.dogma.particles import (
    NORMAL,
    Birth,
    Motion,
    Particles,
    Returns,
    hashed,
    next_counter,
    predict_particles,
    random_stream,
    resample_particles,
    sort_by_cell,
    uniform,
    weight_particles,
)

SIZE = 5
STILL = Motion(*map(np.float32, (1.0, 0.0, 0.0, 0.0, 0.0, 0.1)))
NOWHERE = Returns(np.full((SIZE * SIZE, 2), np.nan, np.float32), np.float32(0.5), np.float32(0.0))
BIRTH = Birth(np.full(SIZE * SIZE, 0.25, np.float32), np.float32(2.0))


def scattered(count: int, seed: int = 0) -> Particles:
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, SIZE + 1, (2, count)).astype(np.float32)
    return Particles(*places, *rng.normal(0, 1, (2, count)).astype(np.float32))


def sorted_by_cell(particles: Particles, motion: Motion = STILL) -> tuple[Particles, np.ndarray]:
    count = particles.x.size
    cells, starts, out = np.empty(count, np.int32), np.empty(SIZE * SIZE + 2, np.int32), Particles.empty(count)
    predict_particles(particles, count, SIZE, motion, random_stream(1, 1), cells, starts)
    sort_by_cell(particles, count, cells, starts, out)
    return out, starts


def cell_of(particles: Particles) -> np.ndarray:
    inside = (particles.x >= 0) & (particles.x < SIZE) & (particles.y >= 0) & (particles.y < SIZE)
    cell = np.floor(particles.y) * SIZE + np.floor(particles.x)
    return np.where(inside, cell, SIZE * SIZE).astype(int)


def resampled(particles: Particles, starts, persistent, born, returns=NOWHERE, wanted=1000, number=3):
    weights, out = np.empty(particles.x.size, np.float32), Particles.empty(wanted)
    persisted = np.empty((SIZE * SIZE, 2), np.int32)
    weight_particles(particles, starts, persistent, returns, weights)
    filled = resample_particles(
        particles, starts, weights, born, returns, BIRTH, random_stream(1, number), out, persisted
    )
    return out, persisted, filled, weights


def test_without_noise_particles_move_by_their_velocity() -> None:
    before = scattered(2000)
    after_it = Particles(*(column.copy() for column in before))
    sorted_by_cell(after_it, STILL._replace(periods=np.float32(3.0)))
    assert np.allclose(after_it.x, before.x + 3 * before.vx, atol=1e-5)
    assert np.allclose(after_it.y, before.y + 3 * before.vy, atol=1e-5)


def test_counting_sort_agrees_with_numpys() -> None:
    particles = scattered(3000)
    found, starts = sorted_by_cell(particles)
    cells = cell_of(particles)
    order = np.argsort(cells, kind="stable")
    for column, moved in zip(found, particles, strict=True):
        assert np.array_equal(column, moved[order])
    assert np.array_equal(starts, np.concatenate([[0], np.cumsum(np.bincount(cells, minlength=SIZE**2 + 1))]))


def test_process_noise_has_the_stated_moments() -> None:
    count, zeros = 200_000, np.zeros(200_000, np.float32)
    particles = Particles(zeros + 2, zeros + 2, zeros + 1, zeros.copy())
    motion = Motion(*map(np.float32, (1.0, 0.3, 0.5, 0.0, 0.0, 0.1)))
    cells, starts = np.empty(count, np.int32), np.empty(SIZE * SIZE + 2, np.int32)
    predict_particles(particles, count, SIZE, motion, random_stream(5, 1), cells, starts)
    assert particles.vx.mean() == pytest.approx(1.0, abs=0.005)
    assert particles.vx.std() == pytest.approx(0.5, rel=0.01)
    assert particles.x.mean() == pytest.approx(3.0, abs=0.005)
    assert particles.y.std() == pytest.approx(np.hypot(0.3, 0.25), rel=0.01)  # half of the velocity's own noise
    assert np.cov(particles.vx, particles.vy)[0, 1] == pytest.approx(0.0, abs=0.003)


def test_particles_at_rest_stay_until_they_start_and_slow_ones_can_stop() -> None:
    count, zeros = 100_000, np.zeros(100_000, np.float32)
    cells, starts = np.empty(count, np.int32), np.empty(SIZE * SIZE + 2, np.int32)
    resting = Particles(*(zeros + 2 for _ in range(2)), zeros.copy(), zeros.copy())
    predict_particles(resting, count, SIZE, STILL._replace(start=np.float32(0.2)), random_stream(5, 1), cells, starts)
    assert ((resting.vx != 0) | (resting.vy != 0)).mean() == pytest.approx(0.2, abs=0.005)
    creeping = Particles(zeros + 2, zeros + 2, np.where(np.arange(count) < count // 2, 0.05, 1.0).astype("f4"), zeros)
    predict_particles(creeping, count, SIZE, STILL._replace(stop=np.float32(0.3)), random_stream(5, 1), cells, starts)
    stopped = creeping.vx == 0
    assert stopped[: count // 2].mean() == pytest.approx(0.3, abs=0.01)
    assert not stopped[count // 2 :].any()


def test_weights_of_particles_near_a_return_agree_with_a_computation_by_hand() -> None:
    # two particles in cell [0, 0], at the return and two standard deviations from it
    particles = Particles(*(np.array(v, np.float32) for v in ([0.5, 0.5], [0.0, 0.8], [0, 0], [0, 0])))
    points = np.full((SIZE * SIZE, 2), np.nan, np.float32)
    points[0] = (0.5, 0.0)
    persistent = np.zeros(SIZE * SIZE, np.float32)
    persistent[0] = 0.9
    found, starts = sorted_by_cell(particles)
    returns = Returns(points, np.float32(0.4), np.float32(0.25))
    weights = resampled(found, starts, persistent, np.zeros_like(persistent), returns)[3]
    g = np.exp(-2.0)
    near, far = (0.9 * (0.75 / 2 + 0.25 * likelihood / (1 + g)) for likelihood in (1.0, g))
    assert weights == pytest.approx([near, far], rel=1e-5)


def test_resampling_keeps_the_number_of_particles_and_distributes_them_by_mass() -> None:
    found, starts = sorted_by_cell(scattered(4000))
    rng = np.random.default_rng(3)
    persistent, born = rng.uniform(0, 0.9, (2, SIZE * SIZE)).astype(np.float32)
    out, persisted, filled, _ = resampled(found, starts, persistent, born, wanted=5000)
    assert filled == 5000
    expected = (persistent + born) / (persistent + born).sum() * 5000
    assert np.abs(np.bincount(cell_of(out), minlength=SIZE * SIZE + 1)[:-1] - expected).max() <= 2
    lengths = persisted[:, 1] - persisted[:, 0]
    assert np.abs(lengths - persistent / (persistent + born).sum() * 5000).max() <= 2
    for cell, (first, last) in enumerate(persisted):
        assert (cell_of(Particles(*(column[first:last] for column in out))) == cell).all()


def test_newborn_particles_fill_their_cell_and_the_stated_share_rests() -> None:
    found, starts = sorted_by_cell(scattered(10))
    born = np.zeros(SIZE * SIZE, np.float32)
    born[7] = 0.9
    out, persisted, filled, _ = resampled(found, starts, np.zeros_like(born), born, wanted=20_000)
    assert filled == 20_000
    assert (persisted[:, 0] == persisted[:, 1]).all()
    assert (cell_of(out) == 7).all()
    assert out.x.mean() == pytest.approx(2.5, abs=0.01)
    assert out.y.std() == pytest.approx(np.sqrt(1 / 12), rel=0.02)
    resting = (out.vx == 0) & (out.vy == 0)
    assert resting.mean() == pytest.approx(0.25, abs=0.01)
    assert out.vx[~resting].std() == pytest.approx(2.0, rel=0.05)
    assert abs(np.corrcoef(np.stack([out.x, out.y, out.vx, out.vy]))[np.triu_indices(4, 1)]).max() < 0.03


def test_resampling_without_mass_gives_no_particles() -> None:
    found, starts = sorted_by_cell(scattered(10))
    nothing = np.zeros(SIZE * SIZE, np.float32)
    assert resampled(found, starts, nothing, nothing)[2] == 0


def test_random_numbers_are_splitmix64_and_normal() -> None:
    # the first two outputs of SplitMix64 from state 0, as published with the algorithm
    first = np.uint64(next_counter(np.uint64(0)))
    assert hashed(first) == 0xE220A8397B1DCDAF
    assert hashed(np.uint64(next_counter(first))) == 0x6E789E6AA1B965F4
    assert 0.0 <= uniform(np.uint64(hashed(first))) < 1.0
    assert NORMAL.mean() == pytest.approx(0.0, abs=1e-6)
    assert NORMAL.std() == pytest.approx(1.0, abs=0.002)
    assert random_stream(1, 2) != random_stream(2, 1)
