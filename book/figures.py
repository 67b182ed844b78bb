"""Draws the figures of the book's concepts into docs/figures, as SVG, with Python's standard library alone."""

import math
import random
from pathlib import Path

OUT = Path(__file__).resolve().parent.parent / "docs" / "figures"
BLUE, ORANGE, GREY, INK = "#2f6fb0", "#d9701a", "#9aa3ad", "#30363d"


class Figure:
    """A drawing of `width` by `height`; every element is one line of SVG."""

    def __init__(self, width, height):
        self.width, self.height, self.parts = width, height, []

    def add(self, text):
        self.parts.append(text)

    def text(self, x, y, words, size=13, anchor="middle", colour=INK):
        self.add(f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" text-anchor="{anchor}" fill="{colour}">{words}</text>')

    def line(self, points, colour=BLUE, width=2, dash=""):
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        dash = f' stroke-dasharray="{dash}"' if dash else ""
        self.add(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="{width}"{dash}/>')

    def box(self, x, y, width, height, fill="none", stroke=INK):
        self.add(f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{fill}" stroke="{stroke}" rx="3"/>')

    def dot(self, x, y, colour=BLUE, radius=3.0):
        self.add(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{colour}"/>')

    def arrow(self, x0, y0, x1, y1, colour=INK):
        self.line([(x0, y0), (x1, y1)], colour, 1.5)
        turn = math.atan2(y1 - y0, x1 - x0)
        wing = [(x1 - 8 * math.cos(turn + t), y1 - 8 * math.sin(turn + t)) for t in (0.4, -0.4)]
        self.line([wing[0], (x1, y1), wing[1]], colour, 1.5)

    def write(self, name):
        head = (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" '
                f'width="{self.width}" height="{self.height}" font-family="sans-serif">')
        paper = f'<rect width="{self.width}" height="{self.height}" fill="#fff"/>'
        (OUT / name).write_text("\n".join([head, paper, *self.parts, "</svg>"]) + "\n")


def spot(s):
    """The profile of models/spot.toml, 1 in the middle and 0 from s = 1 on."""
    return max(0.0, (1 - s) ** 2 * (1 + s / 2)) if s < 1 else 0.0


def pixels():
    figure, side = Figure(620, 300), 46
    for j in range(5):
        for i in range(8):
            s = ((i - 3.3) ** 2 + (j - 2.2) ** 2) / 7
            value = round(20 + 180 * math.exp(-2 * s))
            x, y = 120 + i * side, 40 + j * side
            figure.box(x, y, side, side, f"rgb({value},{value},{value})", GREY)
            figure.text(x + side / 2, y + side / 2 + 4, value, 12, colour="#fff" if value < 120 else "#000")
    for i in range(8):
        figure.text(120 + (i + 0.5) * side, 30, i, 12, colour=GREY)
    for j in range(5):
        figure.text(106, 40 + (j + 0.5) * side + 4, j, 12, colour=GREY)
    figure.text(510, 30, "x →", 13, "start")
    figure.text(98, 290, "y ↓", 13)
    x, y = 120 + (3.3 + 0.5) * side, 40 + (2.2 + 0.5) * side
    figure.dot(x, y, ORANGE, 4)
    figure.arrow(560, 235, x + 8, y + 6, ORANGE)
    figure.text(560, 255, "(3.3, 2.2)", 13, colour=ORANGE)
    figure.text(60, 60, "(0, 0)", 13)
    figure.write("pixels.svg")


def model():
    figure = Figure(640, 300)
    x, y = (lambda r: 40 + 160 * (r + 1.6)), (lambda v: 250 - v)
    figure.line([(x(r / 100), y(40 + 170 * spot((r / 100) ** 2))) for r in range(-150, 151)], BLUE, 2.5)
    for r in (-1, 1):
        figure.line([(x(r), y(0)), (x(r), y(90))], ORANGE, 1.5, "5 4")
    figure.text(x(1), y(98), "outline, s = 1", 13, colour=ORANGE)
    figure.line([(x(-1.5), y(0)), (x(1.5), y(0))], INK, 1)
    figure.line([(x(-1.45), y(-14)), (x(1.45), y(-14))], GREY, 6)
    figure.text(x(0), y(-36), "domain: the pixels that take part", 13, colour=GREY)
    figure.arrow(x(-1.3), y(0), x(-1.3), y(38))
    figure.text(x(-1.3) + 8, y(16), "v0", 13, "start")
    figure.arrow(x(0), y(40), x(0), y(206))
    figure.text(x(0) + 8, y(120), "v1", 13, "start")
    figure.text(x(0), y(222), "bx", 13)
    figure.add(f'<ellipse cx="585" cy="120" rx="38" ry="26" fill="none" stroke="{ORANGE}" stroke-width="2" transform="rotate(-20 585 120)"/>')
    figure.dot(585, 120)
    figure.text(585, 170, "seen from above", 12, colour=GREY)
    figure.write("model.svg")


def starts():
    figure = Figure(620, 270)
    f = lambda b: 150 - 105 * math.exp(-((b - 330) / 60) ** 2) - 38 * math.exp(-((b - 120) / 32) ** 2) - 30 * math.exp(-((b - 510) / 30) ** 2)
    y = lambda b: 220 - f(b)
    figure.line([(b, y(b)) for b in range(40, 590, 3)], BLUE, 2.5)
    for b, end, colour in ((250, 318, "#2c8a4b"), (395, 342, "#2c8a4b"), (152, 128, ORANGE), (480, 503, ORANGE)):
        figure.dot(b, y(b), colour, 5)
        figure.arrow(b, y(b) + 12, end, y(end) + 12, colour)
    figure.text(330, 205, "the target", 13, colour="#2c8a4b")
    figure.text(120, 145, "something else", 13, colour=ORANGE)
    figure.text(510, 135, "something else", 13, colour=ORANGE)
    figure.text(310, 255, "where the centre is taken to be", 13)
    figure.text(24, 40, "F", 14)
    figure.write("starts.svg")


def noise():
    figure, chance = Figure(640, 280), random.Random(3)
    for value in range(10, 241, 6):
        deviation = math.sqrt(0.8**2 + 0.051 * value)
        for _ in range(5):
            figure.dot(40 + value, 130 - 14 * chance.gauss(0, deviation), GREY, 1.6)
    for sign in (1, -1):
        figure.line([(40 + v, 130 - sign * 14 * math.sqrt(0.64 + 0.051 * v)) for v in range(10, 241, 5)], ORANGE, 2)
    figure.text(165, 262, "brightness of the pixel, DN", 13)
    figure.text(165, 20, "differences between two pictures of one scene", 12)
    figure.text(296, 80, "1 σ", 13, colour=ORANGE)
    for cx, rx, ry, turn, words in ((420, 40, 20, -25, "little light"), (560, 18, 9, -25, "four times the light")):
        figure.add(f'<ellipse cx="{cx}" cy="130" rx="{rx}" ry="{ry}" fill="none" stroke="{BLUE}" stroke-width="2" transform="rotate({turn} {cx} 130)"/>')
        figure.dot(cx, 130, BLUE, 2.5)
        figure.text(cx, 195, words, 12)
    figure.text(490, 20, "how well the centre is known", 12)
    figure.write("noise.svg")


def saturation():
    figure = Figure(640, 280)
    x, y = (lambda r: 210 + 130 * r), (lambda v: 250 - 0.62 * v)
    true = lambda r: 20 + 330 * math.exp(-2 * r * r)
    points = [r / 50 for r in range(-75, 76)]
    figure.line([(x(r), y(true(r))) for r in points], GREY, 1.5, "5 4")
    figure.line([(x(r), y(min(255, true(r)))) for r in points], BLUE, 2.5)
    figure.line([(x(-1.5), y(255)), (x(1.5), y(255))], ORANGE, 1)
    figure.text(x(1.5) + 4, y(255) + 4, "255: the camera’s limit", 12, "start", ORANGE)
    figure.text(x(0.2), y(345), "the light", 12, "start", GREY)
    figure.text(x(0.95), y(130), "the pixels", 12, "start", BLUE)
    for i, (word, what) in enumerate((("dropped", "leaves the flat pixels out"), ("predicted", "leaves out what the model expects there"), ("censored", "takes them as “at least 255”"))):
        figure.text(420, 150 + 40 * i, word, 13, "start", INK)
        figure.text(420, 166 + 40 * i, what, 11, "start", GREY)
    figure.write("saturation.svg")


def stages():
    figure = Figure(640, 170)
    names = (("bx, by", "roughly where"), ("bx, by, a1, a2, a3", "and how large"), ("all", "and how bright; covariance"))
    for i, (what, why) in enumerate(names):
        x = 20 + 210 * i
        figure.box(x, 40, 170, 70, "#f2f6fb", BLUE)
        figure.text(x + 85, 72, what, 14)
        figure.text(x + 85, 94, why, 12, colour=GREY)
        figure.text(x + 85, 30, f"stage {i}", 12, colour=GREY)
        if i < 2:
            figure.arrow(x + 172, 75, x + 206, 75)
    figure.text(320, 145, "each stage starts where the one before it ended", 13)
    figure.write("stages.svg")


def sessions():
    figure = Figure(640, 250)
    boxes = {"camera": (20, 30), "recording": (20, 150), "session A": (240, 30), "session B": (240, 90), "session C": (240, 150),
             "isophote watch": (460, 30), "the page": (460, 90), "your program": (460, 150)}
    for name, (x, y) in boxes.items():
        figure.box(x, y, 150, 40, "#f2f6fb", BLUE)
        figure.text(x + 75, y + 25, name, 13)
    for a, b in (("camera", "session A"), ("camera", "session B"), ("recording", "session C"), ("session A", "isophote watch"),
                 ("session A", "the page"), ("session B", "your program"), ("session C", "your program")):
        (x0, y0), (x1, y1) = boxes[a], boxes[b]
        figure.arrow(x0 + 152, y0 + 20, x1 - 3, y1 + 20)
    for x, words in ((95, "sources: frames"), (315, "sessions: model + memory"), (535, "subscribers: estimates")):
        figure.text(x, 225, words, 13, colour=GREY)
    figure.write("sessions.svg")


def judging():
    """What the page's two models leave of a slope of 0.06 DN a pixel, by column: the even one moves the spot to explain it."""
    figure, chance, half, width = Figure(640, 270), random.Random(5), 16, 8
    bell = lambda c, r: math.exp(-2 * (c * c + r * r) / width**2)
    inside = [(c, r) for c in range(-half, half + 1) for r in range(-half, half + 1) if c * c + r * r < half * half]
    weight = lambda c, r: 1 / (0.8**2 + 0.051 * (30 + 60 * bell(c, r)))
    moved = sum(weight(c, r) * 0.06 * c * c * bell(c, r) for c, r in inside)
    moved /= sum(weight(c, r) * (c * bell(c, r)) ** 2 for c, r in inside)
    for panel, (words, wrong) in enumerate((("even", True), ("sloping", False))):
        x = lambda c: 40 + 310 * panel + 8 * (c + half)
        figure.line([(x(-half), 130), (x(half), 130)], GREY, 1)
        points, colour = [], ORANGE if wrong else BLUE
        for column in range(1 - half, half):
            rows = [r for c, r in inside if c == column]
            left = [0.06 * column - moved * column * bell(column, r) if wrong else 0.0 for r in rows]
            variance = sum(1 / weight(column, r) for r in rows) / 20 / len(rows) ** 2
            points.append((x(column), 130 - 90 * (sum(left) / len(rows) + chance.gauss(0, math.sqrt(variance)))))
        figure.line(points, colour, 1.5)
        for point in points:
            figure.dot(*point, colour, 2.5)
        figure.text(x(0), 255, f"{words}: mean residual by column", 13)
    figure.text(22, 44, "+1 DN", 11)
    figure.text(22, 224, "−1 DN", 11)
    figure.write("judging.svg")


if __name__ == "__main__":
    OUT.mkdir(parents=True, exist_ok=True)
    for draw in (pixels, model, starts, noise, saturation, stages, sessions, judging):
        draw()
