"""NumPy's, SciPy's and OpenCV's ways to a spot's centre, as a careful user writes them: analytic Jacobians, weights where they are of use,
arrays that are kept from frame to frame, one thread, the last answer as the start.
In: a course's file (course.rs says how it is written). Out: a line for each frame and method: name, microseconds, x, y; and
`skipped` with the name of what cannot be imported.
"""
import os
import sys
import time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"


def skipped(what, error):
    print(f"skipped\t{what}: {error}")


try:
    import numpy as np
except ImportError as error:
    skipped("NumPy, SciPy and OpenCV", error)
    sys.exit()

data = np.memmap(sys.argv[1], dtype=np.uint8, mode="r")
head = data[:128].view("<f8")
count, width, height = (int(n) for n in head[:3])
gain, read_noise, full, k1, k2, reach = head[3:9]
start = head[9:16].copy()  # bx, by, a1, a2, a3, v0, v1
record = np.dtype([("place", "<f8", 6), ("pixels", "u1", (height, width))])
frames = np.frombuffer(data, dtype=record, offset=128)


def gaussian(s):
    """exp(-2 s) and its derivative."""
    f = np.exp(-2.0 * s)
    return f, -2.0 * f


def profile(s):
    """f(s) of the spot and its derivative."""
    k3 = -(1.0 + k1 + k2)
    inside = s < 1.0
    return inside * (1.0 + s * (k1 + s * (k2 + s * k3))), inside * (k1 + s * (2.0 * k2 + 3.0 * k3 * s))


class Fit:
    """v0 + v1 f(s) over the pixels of the domain at the prediction that are not saturated, weighed as the noise is there."""

    def __init__(self, radial, reach, solve):
        self.radial, self.reach, self.solve = radial, reach, solve
        self.last, self.shape = start, None

    def choose(self, window, p):
        """Pixels and weights."""
        if self.shape != window.shape:
            self.shape = window.shape
            self.rows, self.columns = (a.astype(float).ravel() for a in np.indices(window.shape))
        values = window.ravel()
        x, y = self.columns - p[0], self.rows - p[1]
        s = x * (p[2] * x + 2.0 * p[3] * y) + p[4] * y * y
        kept = np.flatnonzero((s <= self.reach) & (values < full))
        self.dx, self.dy, self.values = self.columns[kept], self.rows[kept], values[kept].astype(float)
        mean = np.maximum(p[5] + p[6] * self.radial(s[kept])[0], 0.0)
        self.weights = 1.0 / np.sqrt(gain * mean + read_noise**2 + 1.0 / 12.0)
        self.at, self.jacobian = None, np.empty((kept.size, 7))

    def model(self, p):
        if not np.array_equal(p, self.at):
            self.at = p.copy()
            self.x, self.y = self.dx - p[0], self.dy - p[1]
            s = self.x * (p[2] * self.x + 2.0 * p[3] * self.y) + p[4] * self.y * self.y
            self.f, self.slope = self.radial(s)
        return p[5] + p[6] * self.f

    def residuals(self, p):
        return (self.model(p) - self.values) * self.weights

    def derivatives(self, p):
        self.model(p)
        x, y, j = self.x, self.y, self.jacobian
        slope = p[6] * self.slope * self.weights
        j[:, 0] = slope * (-2.0) * (p[2] * x + p[3] * y)
        j[:, 1] = slope * (-2.0) * (p[3] * x + p[4] * y)
        sx = slope * x
        j[:, 2] = sx * x
        j[:, 3] = 2.0 * sx * y
        j[:, 4] = slope * y * y
        j[:, 5] = self.weights
        j[:, 6] = self.f * self.weights
        return j

    def __call__(self, window, place):
        p = self.last.copy()
        p[:2] = place[0] - place[2], place[1] - place[3]
        self.choose(window, p)
        p, good = self.solve(self, p)
        self.last = p if good else start
        return (p[0] + place[2], p[1] + place[3]) if good else (np.nan, np.nan)


def by_scipy(fit, p):
    """Levenberg-Marquardt of MINPACK."""
    found = least_squares(fit.residuals, p, jac=fit.derivatives, method="lm", x_scale="jac", ftol=1e-6, xtol=1e-6)
    return found.x, found.success


def by_normal_equations(fit, p):
    """Gauss-Newton steps until one is predicted to change chi square by less than 0.01."""
    for _ in range(10):
        r, j = fit.residuals(p), fit.derivatives(p)
        gradient = j.T @ r
        step = np.linalg.solve(j.T @ j, -gradient)
        p = p + step
        if -(gradient @ step) < 0.01:
            return p, True
    return p, False


def ground(window):
    """The mean of the window's rim."""
    rim = window[0], window[-1], window[:, 0], window[:, -1]
    return sum(cv2.mean(np.ascontiguousarray(side))[0] * side.size for side in rim) / sum(side.size for side in rim)


def moments(window, place):
    """The centre of gravity of what is brighter than the ground by a share of the height."""
    light = window.astype(np.float32) - np.float32(ground(window))
    level = MOMENTS * cv2.minMaxLoc(light)[1]
    m = cv2.moments(cv2.threshold(light, level, 0, cv2.THRESH_TOZERO)[1])
    return m["m10"] / m["m00"] + place[2], m["m01"] / m["m00"] + place[3]


def contour(window, place, finer=1):
    """The ellipse through the outline of what is brighter than a level, of a window made so many times finer."""
    dark = ground(window)
    level = dark + CONTOUR * (cv2.minMaxLoc(window)[1] - dark)
    if finer > 1:
        window = cv2.resize(cv2.GaussianBlur(window, (0, 0), BLUR_PX), None, fx=finer, fy=finer)
    bright = cv2.threshold(window, level, 255, cv2.THRESH_BINARY)[1]
    outline = max(cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len, default=())
    if len(outline) < 5:
        return np.nan, np.nan
    (x, y), _, _ = cv2.fitEllipse(outline)
    return (x + 0.5) / finer - 0.5 + place[2], (y + 0.5) / finer - 0.5 + place[3]


# Shares of the height, and a blur: those with the smallest errors on these frames.
MOMENTS = 0.03
CONTOUR = 0.3
BLUR_PX = 1.5
methods = [("Python, NumPy, same profile", Fit(profile, reach, by_normal_equations))]
try:
    from scipy.optimize import least_squares

    # A Gaussian's outline is narrower than the spot's rim.
    methods += [("Python, SciPy, Gaussian", Fit(gaussian, 1.4 * reach, by_scipy)), ("Python, SciPy, same profile", Fit(profile, reach, by_scipy))]
except ImportError as error:
    skipped("SciPy", error)
try:
    import cv2

    cv2.setNumThreads(1)
    methods += [("OpenCV, moments", moments), ("OpenCV, ellipse of a contour", contour)]
    methods += [("OpenCV, ellipse of a finer contour", lambda window, place: contour(window, place, 4))]
except ImportError as error:
    skipped("OpenCV", error)

for name, method in methods:
    for frame in frames:
        place = frame["place"]
        x, y, w, h = (int(n) for n in place[2:])
        begin = time.perf_counter_ns()
        centre = method(frame["pixels"][y : y + h, x : x + w], place)
        took = (time.perf_counter_ns() - begin) / 1e3
        print(f"{name}\t{took:.3f}\t{centre[0]:.6f}\t{centre[1]:.6f}")
