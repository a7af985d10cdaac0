import shutil
import subprocess
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[2] / "firmware"


@pytest.mark.parametrize("variant", ["100hz", "200hz", "400hz"])
def test_elf_and_hex_fit_the_chip(firmware, variant):
    sizes = subprocess.run(
        ["avr-size", firmware / f"strap_board_{variant}.elf"], capture_output=True, text=True, check=True
    ).stdout.split()
    text, data, bss = map(int, sizes[6:9])
    assert text + data <= 32 * 1024 - 512  # behind them the boot loader
    assert data + bss <= 1024  # half of the RAM is the stack's
    hex_lines = (firmware / f"strap_board_{variant}.hex").read_text().split()
    assert hex_lines[-1] == ":00000001FF"
    assert sum(int(line[1:3], 16) for line in hex_lines if line[7:9] == "00") == text + data


@pytest.mark.parametrize(
    ("rate_hz", "osr", "baud", "named"),
    [
        (400, 3, 250_000, "does not fit the period"),
        (200, 7, 115_200, "does not fit the period"),
        (400, 2, 115_200, "90 % of the line"),
        (300, 2, 250_000, "a divisor of 1000000"),
        (200, 0, 115_200, "OSR: 1..64"),
        (100, 4, 921_600, "2.5 % off"),
    ],
)
def test_what_does_not_fit_is_not_built(firmware, rate_hz, osr, baud, named):
    options = [f"-DRATE_HZ={rate_hz}", f"-DOSR={osr}", f"-DBAUD={baud}", "-DF_CPU=16000000UL", "-mmcu=atmega328p"]
    built = subprocess.run(
        ["avr-gcc", *options, "-fsyntax-only", SOURCES / "scan.c"], capture_output=True, text=True, check=False
    )
    assert built.returncode != 0
    assert named in built.stderr


@pytest.mark.skipif(not shutil.which("make"), reason="needs make")
def test_without_the_compiler_one_line_names_the_packages():
    made = subprocess.run(
        ["make", "--no-print-directory", "-C", SOURCES, "HAS_AVR="], capture_output=True, text=True, check=False
    )
    assert made.returncode != 0
    assert "apt install gcc-avr avr-libc binutils-avr" in made.stderr.splitlines()[0]
