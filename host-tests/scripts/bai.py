#!/usr/bin/env python3
"""The twelve installation errors of a log by (11) and (13) of Bai et al., Sensors 2019, 19(18), 4005, sample by sample.

Written from the paper to check `rins replay --method bai`, with which it shares no code. A Kalman filter of random
constants without prior knowledge is least squares with the weights 1 / R, which is what this is. R is that of the guide:
the samples of a stop have one encoder error, those of a move have two, and count together as one measurement. Needs numpy.

    bai.py LOG.csv                    prints the twelve of a log, arcsec
    bai.py --write RINS DATA.json     simulates every log of DATA.json with this program, and writes its twelve there,
                                      and those with (13) and equal weights for all samples
"""
import gzip, json, subprocess, sys, tempfile
import numpy as np

ARCSEC = np.pi / 180 / 3600
EARTH_RATE = 7.292115e-5  # rad/s, WGS-84
NAMES = "Sgxy Sgxz Sgyx Sgyz Sgzx Sgzy Sayz Sazx Sazy alpha beta gamma".split()
FORCE_NOISE, ENCODER_NOISE = 30 * 9.80665e-6, 0.5 * ARCSEC  # --noise bai: m/s^2 a sample, rad a stop
TURNING = 2e-6  # rad per sample
SETTLING_S = 0.3


def cross_matrix(v):
    x, y, z = np.moveaxis(v, -1, 0)
    o = 0 * x
    return np.moveaxis(np.array([[o, -z, y], [z, o, -x], [-y, x, o]]), (0, 1), (-2, -1))


def rot_rr0(outer, inner):
    """(3): R_inner R_outer, for every pair of angles."""
    (so, co), (si, ci), o, one = (np.sin(outer), np.cos(outer)), (np.sin(inner), np.cos(inner)), 0 * outer, 0 * outer + 1
    about_x = np.moveaxis(np.array([[one, o, o], [o, co, so], [o, -so, co]]), (0, 1), (-2, -1))
    about_z = np.moveaxis(np.array([[ci, si, o], [-si, ci, o], [o, o, one]]), (0, 1), (-2, -1))
    return about_z @ about_x


def F(f):
    x, y, _ = np.moveaxis(f, -1, 0)
    o = 0 * x
    return np.moveaxis(np.array([[o, o, o], [x, o, o], [o, y, -x]]), (0, 1), (-2, -1))


def G(w):
    x, y, z = np.moveaxis(w, -1, 0)
    o = 0 * x
    return np.moveaxis(np.array([[z, -y, o, o, o, o], [o, o, -z, x, o, o], [o, o, o, o, y, -x]]), (0, 1), (-2, -1))


def solved(H, z, weights):
    """The state after the last sample: sum w H^T H x = sum w H^T z."""
    return np.linalg.solve(np.einsum("k,kij,kil->jl", weights, H, H), np.einsum("k,kij,ki->j", weights, H, z))


def estimate(path, latitude_deg=30.93041, equal_weights=False):
    with (gzip.open if path.endswith(".gz") else open)(path, "rt") as log:
        log = np.genfromtxt(log, delimiter=",", names=True)
    column = lambda names: np.stack([log[name] for name in names.split()], -1)
    w_g, f_a = column("gyro_x_rad_s gyro_y_rad_s gyro_z_rad_s"), column("accel_x_m_s2 accel_y_m_s2 accel_z_m_s2")
    step_s = np.median(np.diff(log["time_s"]))
    angles = [np.unwrap(log[name]) for name in ("outer_rad", "inner_rad")]
    # The mean rates over the interval of a sample, whose middle is its time.
    outer_rate, inner_rate = [np.gradient(angle, step_s) for angle in angles]
    turning = (np.abs(outer_rate) > TURNING / step_s) | (np.abs(inner_rate) > TURNING / step_s)
    margin = int(SETTLING_S / step_s)
    near_a_move = np.convolve(turning, np.ones(2 * margin + 1), "same") > 0.5
    # Number of moves begun up to each sample, and whether it is of the first period.
    moves = np.cumsum(np.diff(near_a_move.astype(int), prepend=0) == 1)
    first_period = moves[-1] // 2
    R = rot_rr0(*angles)

    # Stage 1: (11) at the stops of period one. At the first stop R is the unit matrix.
    first = ~near_a_move & (moves == 0)
    f_a0 = f_a[first].mean(0)
    stops = ~near_a_move & (moves > 0) & (moves <= first_period)
    back = np.swapaxes(R[stops], -1, -2)
    returned = np.einsum("kij,kj->ki", back, f_a[stops])
    H1 = np.concatenate([back @ F(f_a[stops]) - F(f_a0), cross_matrix(returned) @ (np.eye(3) - back)], -1)
    samples = np.bincount(moves[~near_a_move])
    R1 = FORCE_NOISE**2 * (1 / samples + 1 / samples[0]) + (np.linalg.norm(f_a0) * ENCODER_NOISE) ** 2
    x1 = solved(H1, f_a0 - returned, (1 / (samples * R1))[moves[stops]])
    theta = x1[3:]

    # (4), (8): the first stop, levelled, with the heading that its gyros give.
    to_s, to_r = np.eye(3) - cross_matrix(theta), np.eye(3) + cross_matrix(theta)
    up = to_r @ (f_a0 + F(f_a0) @ x1[:3])
    up /= np.linalg.norm(up)
    w = to_r @ w_g[first].mean(0)
    north = w - up * (up @ w)
    north /= np.linalg.norm(north)
    latitude = np.radians(latitude_deg)
    w_ie = EARTH_RATE * (np.cos(latitude) * north + np.sin(latitude) * up)

    # Stage 2: (12) and (13) while turning, in period two.
    turns = near_a_move & (moves > first_period)
    outer_axis = rot_rr0(0 * angles[1], angles[1])[turns][:, :, 0]
    w_r = outer_axis * outer_rate[turns, None] + np.array([0.0, 0.0, 1.0]) * inner_rate[turns, None]
    z2 = w_g[turns] - (R[turns] @ w_ie + w_r) @ to_s.T
    w, move = w_g[turns], moves[turns] - first_period - 1
    if not equal_weights:
        # (13) is linear in z2 and w_g: a move counts with their sums.
        w, z2 = [np.stack([np.bincount(move, values) for values in v.T], -1) for v in (w, z2)]
    x2 = solved(-G(w), z2, np.ones(len(w)))
    return {name: value / ARCSEC for name, value in zip(NAMES, np.concatenate([x2, x1]))}


if __name__ == "__main__":
    if sys.argv[1] == "--write":
        rins, path = sys.argv[2:]
        data = json.load(open(path))
        for unit in data["units"]:
            with tempfile.TemporaryDirectory() as folder:
                out = ["--out", f"{folder}/log.csv", "--truth", f"{folder}/truth.json"]
                subprocess.run([rins, "simulate", "--quiet", *unit["simulate"], *out], check=True)
                for key, equal_weights in [("estimates_arcsec", False), ("equal_weights_arcsec", True)]:
                    found = estimate(f"{folder}/log.csv", equal_weights=equal_weights)
                    unit[key] = {name: round(value, 5) for name, value in found.items()}
        open(path, "w").write(json.dumps(data, indent=1) + "\n")
    else:
        print(json.dumps(estimate(sys.argv[1]), indent=1))
