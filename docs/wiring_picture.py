"""Draw docs/images/wiring.svg: one wheel's strap, slip ring, pull-downs and buffers, and two boards for six wheels."""

import math
from pathlib import Path

PICTURE = Path(__file__).parent / "images" / "wiring.svg"
WIDTH, HEIGHT = 1320, 900
SUPPLY, SIGNAL_A, SIGNAL_B, PLAIN = "#c0392b", "#1f6fb4", "#2e8b57", "#222222"


class Drawing:
    """Lines of an SVG."""

    def __init__(self) -> None:
        head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
        head += f'height="{HEIGHT}" font-family="Helvetica, Arial, sans-serif" font-size="15">'
        self._parts = [head, f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>']

    def wire(self, *points: tuple[float, float], color: str = PLAIN, width: float = 2.0, dash: str = "") -> None:
        """A line through `points`."""
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="{width}" '
            f'stroke-linejoin="round"{dashes}/>'
        )

    def text(self, x: float, y: float, words: str, anchor: str = "start", color: str = PLAIN, size: int = 15) -> None:
        """Words, `anchor` of them at (x, y)."""
        self._parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{color}" font-size="{size}">{words}</text>'
        )

    def box(
        self, x: float, y: float, width: float, height: float, color: str = PLAIN, fill: str = "none", dash: str = ""
    ) -> None:
        """A rectangle, its upper left corner at (x, y)."""
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self._parts.append(
            f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="4" fill="{fill}" stroke="{color}" '
            f'stroke-width="1.6"{dashes}/>'
        )

    def dot(self, x: float, y: float, color: str = PLAIN) -> None:
        """Where wires are joined."""
        self._parts.append(f'<circle cx="{x}" cy="{y}" r="4" fill="{color}"/>')

    def arc(self, x: float, y: float, radius: float, start: float, end: float, color: str, width: float) -> None:
        """From `start` to `end` [deg], counted from the right, clockwise on the page."""
        turns = [math.radians(start + (end - start) * step / 90) for step in range(91)]
        self.wire(*[(x + radius * math.cos(a), y + radius * math.sin(a)) for a in turns], color=color, width=width)

    def resistor(self, x: float, y: float, is_upright: bool = False) -> None:
        """A box of 44 x 16 with its middle at (x, y), filled to hide the wire under it."""
        width, height = (16, 44) if is_upright else (44, 16)
        self.box(x - width / 2, y - height / 2, width, height, fill="white")

    def capacitor(self, x: float, y: float, color: str) -> None:
        """Upright, from (x, y) 50 down to ground."""
        self.wire((x, y), (x, y + 20), color=color)
        self.wire((x - 13, y + 20), (x + 13, y + 20), width=3)
        self.wire((x - 13, y + 27), (x + 13, y + 27), width=3)
        self.wire((x, y + 27), (x, y + 50))
        self.ground(x, y + 50)

    def ground(self, x: float, y: float) -> None:
        """The sign for it, its upper line at (x, y)."""
        for row, half in enumerate((12, 8, 4)):
            self.wire((x - half, y + 5 * row), (x + half, y + 5 * row))

    def diode(self, x: float, y: float) -> None:
        """Upright, 24 high, conducting upwards, its middle at (x, y)."""
        self._parts.append(
            f'<polygon points="{x - 9},{y + 8} {x + 9},{y + 8} {x},{y - 8}" fill="white" stroke="{PLAIN}" '
            'stroke-width="1.6"/>'
        )
        self.wire((x - 9, y - 8), (x + 9, y - 8))

    def follower(self, x: float, y: float, color: str) -> tuple[float, float]:
        """An operational amplifier as a follower, its + input at (x, y); returns where its output is."""
        self._parts.append(
            f'<polygon points="{x},{y - 24} {x},{y + 50} {x + 72},{y + 13}" fill="white" stroke="{PLAIN}" '
            'stroke-width="2"/>'
        )
        self.text(x + 6, y + 5, "+")
        self.text(x + 6, y + 32, "&#8722;")
        self.wire((x, y + 27), (x - 16, y + 27), (x - 16, y + 66), (x + 88, y + 66), (x + 88, y + 13), color=color)
        self.wire((x + 72, y + 13), (x + 88, y + 13), color=color)
        self.dot(x + 88, y + 13, color)
        return x + 88, y + 13

    def save(self, path: Path) -> None:
        """Write the file."""
        path.write_text("\n".join([*self._parts, "</svg>", ""]), encoding="utf-8")


def draw_wheel(d: Drawing, x: float, y: float) -> None:
    d.arc(x, y, 112, 0, 360, "#999999", 1.5)
    d.arc(x, y, 124, -82, 262, PLAIN, 8)
    d.arc(x, y, 142, -82, 262, SUPPLY, 4)
    d.arc(x, y, 133, 62, 104, "#d99a00", 14)
    d.text(x, y - 168, "wheel, seen from outside", "middle")
    d.text(x, y + 60, "strap, R_str", "middle")
    d.text(x, y + 40, "graphite", "middle", size=13)
    d.text(x, y + 172, "sand presses strap and conductor", "middle", "#a37400", 13)
    d.text(x, y + 188, "together over the contact arc", "middle", "#a37400", 13)
    d.text(x + 24, y - 82, "A", "middle", SIGNAL_A, 18)
    d.text(x - 24, y - 82, "B", "middle", SIGNAL_B, 18)
    d.text(x - 158, y - 128, "conductor", "start", SUPPLY, 13)
    end_a = (x + 124 * math.cos(math.radians(-82)), y + 124 * math.sin(math.radians(-82)))
    end_b = (x + 124 * math.cos(math.radians(262)), y + 124 * math.sin(math.radians(262)))
    d.wire(end_a, (end_a[0], y - 10), (x + 240, y - 10), color=SIGNAL_A)
    d.wire(end_b, (end_b[0], y + 20), (x + 240, y + 20), color=SIGNAL_B)
    # The supply leaves the conductor at the seam, outside of the strap.
    d.wire(
        (x + 142 * math.cos(math.radians(-60)), y + 142 * math.sin(math.radians(-60))), (x + 240, y - 123), color=SUPPLY
    )
    d.dot(round(x + 142 * math.cos(math.radians(-60)), 1), round(y + 142 * math.sin(math.radians(-60)), 1), SUPPLY)


def draw_channel(d: Drawing, y: float, name: str, color: str, pin: str) -> None:
    """From behind the slip ring at x = 520 to the converter's pin at x = 1180."""
    d.wire((520, y), (690, y), color=color)
    d.dot(540, y, color)
    d.wire((540, y), (540, y + 90), color=color)
    d.resistor(540, y + 45, is_upright=True)
    d.ground(540, y + 90)
    d.text(554, y + 44, f"R_{name}")
    d.text(554, y + 62, "453 k", size=13)
    d.resistor(592, y)
    d.text(592, y - 14, "10 k", "middle", size=13)
    d.dot(636, y, color)
    d.capacitor(636, y, color)
    d.text(618, y + 44, "1 n", "end", size=13)
    d.dot(680, y, color)
    d.wire((680, y + 56), (680, y - 66))
    d.diode(680, y - 34)
    d.diode(680, y + 30)
    d.ground(680, y + 56)
    d.wire((674, y - 66), (686, y - 66), color=SUPPLY, width=3)
    d.text(690, y - 60, "5 V", "start", SUPPLY, 13)
    d.text(666, y - 30, "BAV199", "end", size=13)
    out_x, out_y = d.follower(732, y, color)
    d.wire((680, y), (732, y), color=color)
    d.wire((out_x, out_y), (1180, out_y), color=color)
    d.resistor(886, out_y)
    d.text(886, out_y - 14, "470", "middle", size=13)
    d.wire((924, out_y - 8), (974, out_y - 8), width=1, dash="4 3")
    d.wire((924, out_y + 8), (974, out_y + 8), width=1, dash="4 3")
    d.text(949, out_y - 16, "cable", "middle", size=13)
    d.dot(1010, out_y, color)
    d.capacitor(1010, out_y, color)
    d.text(1026, out_y + 40, "100 n", "start", size=13)
    d.dot(1096, out_y, color)
    d.wire((1096, out_y), (1096, out_y + 72))
    d.resistor(1096, out_y + 40, is_upright=True)
    d.ground(1096, out_y + 72)
    d.text(1110, out_y + 45, "1 M", "start", size=13)
    d.dot(1180, out_y, color)
    d.text(1190, out_y + 5, pin, "start", color, 16)


def draw_one_wheel(d: Drawing) -> None:
    d.text(24, 32, "One wheel", size=20)
    draw_wheel(d, 180, 300)
    # Slip ring: three circuits.
    d.box(420, 150, 70, 215, dash="6 4")
    d.text(455, 140, "slip ring", "middle")
    for y, color in ((177, SUPPLY), (290, SIGNAL_A), (320, SIGNAL_B)):
        d.wire((420, y), (444, y), color=color)
        d.wire((466, y), (490, y), color=color)
        d.arc(455, y, 11, 0, 360, color, 2.5)
    d.text(455, 354, "3 circuits", "middle", size=13)
    # Supply of the conductor, from the right.
    d.wire((490, 177), (502, 177), (502, 84), (1180, 84), color=SUPPLY)
    d.resistor(560, 84)
    d.text(560, 68, "100 (limits a short to 50 mA)", "middle", size=13)
    d.dot(1180, 84, SUPPLY)
    d.text(1190, 89, "5V", "start", SUPPLY, 16)
    d.dot(870, 84, SUPPLY)
    d.capacitor(870, 84, SUPPLY)
    d.text(886, 124, "100 n + 10 u, at the amplifier", "start", size=13)
    # Channel A higher, channel B lower.
    d.wire((490, 290), (512, 290), (512, 240), (520, 240), color=SIGNAL_A)
    d.wire((490, 320), (500, 320), (500, 440), (520, 440), color=SIGNAL_B)
    draw_channel(d, 240, "A", SIGNAL_A, "A0 (A2, A4)")
    draw_channel(d, 440, "B", SIGNAL_B, "A1 (A3, A5)")
    d.text(708, 556, "one MCP6002, between 5 V and GND", "middle", size=13)
    d.box(514, 158, 336, 410, dash="6 4")
    d.text(682, 590, "beside the slip ring, on the body's side", "middle", size=14)
    d.wire((1180, 530), (1140, 530), (1140, 546))
    d.ground(1140, 546)
    d.dot(1180, 530)
    d.text(1190, 535, "GND", "start", PLAIN, 16)
    d.box(1180, 50, 120, 520)
    d.text(1240, 40, "Arduino Uno", "middle")


def draw_six_wheels(d: Drawing) -> None:
    top = 640
    d.text(24, top, "Six wheels, two boards", size=20)
    rows = [("fl", "ml", "rl"), ("fr", "mr", "rr")]
    sides = ("left", "right")
    for board, (wheels, side) in enumerate(zip(rows, sides, strict=True), 1):
        left = 40 + (board - 1) * 640
        d.box(left + 400, top + 24, 170, 176)
        d.text(left + 485, top + 52, f"Uno, board {board}", "middle")
        d.text(left + 485, top + 74, f"(i{board} and Enter)", "middle", size=13)
        d.text(left + 485, top + 150, "USB", "middle", size=13)
        d.text(left + 485, top + 186, f"/dev/strap_board_{board}", "middle", size=13)
        d.wire((left + 485, top + 200), (left + 485, top + 226), width=3)
        d.text(left + 500, top + 222, "to the computer", "start", size=13)
        for row, wheel in enumerate(wheels):
            y = top + 50 + 62 * row
            d.box(left, y - 22, 130, 48)
            d.text(left + 65, y - 2, f"wheel {wheel}", "middle")
            d.text(left + 65, y + 17, f"{side}, channel {row}", "middle", size=13)
            d.box(left + 190, y - 22, 120, 48)
            d.text(left + 250, y - 2, "pull-downs,", "middle", size=13)
            d.text(left + 250, y + 15, "2 amplifiers", "middle", size=13)
            for offset, color in ((-12, SUPPLY), (2, SIGNAL_A), (16, SIGNAL_B)):
                d.wire((left + 130, y + offset), (left + 190, y + offset), color=color)
            for offset, color, pin in ((-10, SIGNAL_A, 2 * row), (14, SIGNAL_B, 2 * row + 1)):
                d.wire((left + 310, y + offset), (left + 400, y + offset), color=color)
                d.text(left + 392, y + offset - 4, f"A{pin}", "end", color, 13)


def main() -> None:
    drawing = Drawing()
    draw_one_wheel(drawing)
    draw_six_wheels(drawing)
    drawing.save(PICTURE)
    print(f"wrote {PICTURE}")


if __name__ == "__main__":
    main()
