"""Write identification-side-by-side.md, or check it: python docs/studies/identification_side_by_side.py [--check].

Every number of ours is computed anew from the records of the other programs' problems and shown to as many digits as
theirs are known to. Problems F and G are real records that are not shipped: set FDD_SHARED to the folder that holds
``data/``; without it their rows are left as they are.
"""

# ruff: noqa: E501 - rows of tables
from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from fdd.greybox.fit import fit  # noqa: E402
from fdd.greybox.likelihood import Data, Likelihood  # noqa: E402
from fdd.greybox.results import FitResult  # noqa: E402
from tests.greybox import problems, records  # noqa: E402
from tests.greybox import test_identification as cases  # noqa: E402

PAGE = Path(__file__).with_name("identification-side-by-side.md")
DATA = Path(os.environ.get("FDD_SHARED", ROOT.parent / "shared")) / "data"
TESTS = "tests/greybox/"


def quoted(text: str) -> dict[str, tuple[str, str]]:
    """Name, value and error as the other programs' table has them."""
    words = text.replace("(", "").replace(")", "").split()
    return {name: (v, e) for name, v, e in zip(words[::3], words[1::3], words[2::3], strict=True)}


C_OPTIMUM = quoted("th 5.288194 (.6188) mu 2.983602 (.05413) lsx .220886 (.07011) lsy -2.482343 (.4689)")
D_OPTIMUM = quoted("""
    Bus 12.4095 (.1912) Bb 34.384 (1.212) Bn 39.018 (1.364) Bas 535.69 (6.530) Bun 28.0744 (.2552) Ban 616.816 (8.130)
    Cis 433.140 (5.193) Cas 1533.46 (17.08) Cin 817.757 (7.220) Can 3289.47 (81.69) Aes 1.68269 (.01452)
    lsis -3.54551 (.1155) lsas -3.91930 (.1211) lsin -3.55159 (.0837) lsan -3.90090 (.1233)
    lrs -3.48660 (.0208) lrn -3.48206 (.0195)""")
E_OPTIMUM = quoted("""
    Cr 30.188 (.218) Hr 12.026 (.547) Cl 14.94 (2.87) Bl 120.7 (17.0) a .05857 (.00311) b 2.8819 (.181)
    ls1 -2.47066 (.1498) lsy -2.97187 (.0258)""")
F_OPTIMUM = quoted("""
    Ro .017593 (.000927) Ri .001984 (.000075) Cw 169.597 (7.663) Ci 18.946 (.772) s_w .52134 (.0470)
    s_v .034325 (.00233) Tw0 26.5945 (.1305)""")


@dataclass(frozen=True)
class Row:
    """One number of another program, and ours to as many digits; standard errors in brackets."""

    case: str
    what: str
    program: str
    theirs: str
    ours: float
    test: str
    their_error: str = ""
    our_error: float = math.nan

    def text(self) -> str:
        """The row of the table."""
        theirs, ours = self.theirs, shown(self.ours, self.theirs)
        if self.their_error:
            theirs += f" ({self.their_error})"
            ours += f" ({shown(self.our_error, self.their_error)})"
        return f"| {self.case} | {self.what} | {self.program} | {theirs} | {ours} | {self.test} |"


def shown(value: float, like: str) -> str:
    """A number with the decimals of another as it is written."""
    return f"{value:.{decimals(like)}f}"


def decimals(number: str) -> int:
    """How many decimals are written."""
    return len(number.partition(".")[2])


def likelihoods() -> Iterator[Row]:
    """Problems A to E: likelihoods at given parameters."""
    test = "test_a_ctsm_likelihood_and_predictions"
    wall = Likelihood(problems.ctsm_wall(), cases.wall())
    yield Row("A", "-log L, wall, 719 rows", "CTSM 2.3", "-623.3564", wall.value(cases.A_VALUES), test)
    path, theirs = wall.paths(cases.A_VALUES)[0], records.table("ctsm_heat_predictions", header=0, delimiter=";")
    rms = float(np.sqrt(np.mean((path.predicted[:, 0] - theirs[:, 5]) ** 2)))
    yield Row("A", "rms distance from CTSM's one-step predictions", "exact filter", "0.00013", rms, test)
    rows = records.table("id_ou2d")
    for hold, values, number in (("zero", cases.B_ZERO, "4.80814948092"), ("first", cases.B_FIRST, "1.75327931962")):
        d = Data(rows[:, 0], rows[:, 1:2], rows[:, 2:4], hold=hold)  # type: ignore[arg-type]
        value = Likelihood(problems.ou2d(), d).value(values)
        yield Row("B", f"NLL, hold {hold}", "ctsmTMB", number, value, "test_b_ctsmtmb_reference")
    test, at = "test_c_sampling_of_every_kind", np.array([5.29, 2.98, 0.22, -2.48])
    start = np.array([2, 2, np.log(0.5), np.log(0.05)])
    value = Likelihood(problems.ou1d(), records.ou1d()).value(start)
    yield Row("C", "NLL at the start", "exact filter", "455.1148284941", value, test)
    for kind, number in (("", "59.1994526780"), ("_irregular", "70.2984766"), ("_growing", "53.3317051"),
                         ("_missing", "49.2237602")):  # fmt: skip
        value = Likelihood(problems.ou1d(), records.ou1d(kind)).value(at)
        yield Row("C", f"NLL, {kind.strip('_') or 'regular'} samples", "exact filter", number, value, test)
    m = problems.id_building()
    value = Likelihood(m, records.building_d()).value(np.array([q.typical for q in m.parameters]))
    yield Row(
        "D",
        "NLL at the start",
        "exact filter",
        "-4730.5462803391",
        value,
        "test_d_ends_in_the_global_optimum_never_in_the_trap",
    )
    m, test = problems.id_radiator(), "test_e_radiator_values_and_optimum"
    start = np.array([q.typical for q in m.parameters])
    for substeps, number in ((1, "5817.0275"), (4, "5817.013557")):
        value = Likelihood(m, records.radiator_e(), substeps=substeps).value(start)
        yield Row("E", f"NLL at the start, {substeps} RK4 substep(s)", "exact filter", number, value, test)
    value = Likelihood(m, records.radiator_e(), substeps=64).value(start)
    yield Row("E", "NLL at the start, exact ODE (ours: 64 substeps)", "exact filter", "5817.013512464", value, test)


def kernels() -> Iterator[Row]:
    """The three kernel problems at two parameter vectors each; six programs agreed on them."""
    from tests.greybox.test_kernels import REFERENCE, likelihood

    for name in problems.KERNEL_PROBLEMS:
        for at in ("true", "off"):
            case = REFERENCE[f"{name}_{at}"]
            made, test = likelihood(name), "test_likelihood_and_gradient_are_those_of_the_reference"
            values, theirs = np.exp(case["log_theta"]), case["negative_log_likelihood"]
            yield Row(
                name, f"NLL, parameters {at}", "complex-step matrix filter", f"{theirs:.9f}", made.value(values), test
            )


def optima() -> Iterator[Row]:
    """Problems C, D and E: the best optimum and what was found there."""
    r = fit(problems.ou1d(), records.ou1d())
    test = "test_c_optimum_and_standard_errors"
    yield Row("C", "optimum", "exact filter", "59.1970478", -r.llf, test)
    yield from estimates("C", "exact filter", r, C_OPTIMUM, test)
    r, test = fit(problems.id_building(), records.building_d()), "test_d_ends_in_the_global_optimum_never_in_the_trap"
    for program, number in (("exact filter", "-9362.46640947"), ("ctsmTMB, extended filter", "-9362.465"), ("dynamax", "-9362.466"),
                            ("ctsmTMB, default: a local optimum", "-9337.627"), ("statsmodels, not converged", "-9082.9")):  # fmt: skip
        yield Row("D", "where the fit ends", program, number, -r.llf, test)
    yield from estimates("D", "exact filter", r, D_OPTIMUM, test)
    r, test = fit(problems.id_radiator(), records.radiator_e(), substeps=4), "test_e_radiator_values_and_optimum"
    for program, number in (("exact filter, 4 RK4 substeps", "-1465.117787"), ("ctsmTMB, log parameters", "-1465.120")):
        yield Row("E", "where the fit ends", program, number, -r.llf, test)
    yield from estimates("E", "exact filter", r, E_OPTIMUM, test)


def estimates(case: str, program: str, r: FitResult, theirs: dict[str, tuple[str, str]], test: str) -> Iterator[Row]:
    """Estimates and standard errors."""
    for name, (value, error) in theirs.items():
        yield Row(case, name, program, value, r.params[name], test, error, r.bse[name])


def real() -> Iterator[Row]:
    """Problems F and G: published fits of real buildings."""
    rows = np.genfromtxt(DATA / "armadillo_30min.csv", delimiter=",", names=True)[:-1]
    u = np.column_stack([rows["T_ext"], rows["P_hea"]])
    r = fit(problems.armadillo(), Data(rows["Time"] / 86400, u, rows["T_int"], hold="first"))
    test = "test_f_armadillo_with_estimated_start_and_first_order_hold"
    yield Row("F", "NLL at the optimum", "pySIP", "-331.0573", -r.llf, test)
    yield from estimates("F", "pySIP", r, F_OPTIMUM, test)
    rows = np.genfromtxt(DATA / "flexhouse_prbs_5min.csv", delimiter=",", skip_header=1, usecols=range(5))
    published = {
        "Ti": ("-2478.6437", "Ci 2.07094 Ria 5.28354 Aw 8.0078 p11 -1.63852"),
        "TiTe": ("-3528.8306", "Ci 6.2155 Ce 1.2335 Rie .91883 Rea 3.2489 Aw 28.630 p22 2.2529"),
        "TiTh": ("-3900.7291", "Ci 1.6254 Ch .043364 Ria 5.2979 Rih 3.7507 Aw 6.6825 p22 2.2988"),
        "TiTeTh": ("-5430.2149", "Ci 1.0687 Ce 2.8959 Rie .85629 Rea 4.6131 Aw 6.1041"),
    }
    for kind, (number, values) in published.items():
        r = fit(problems.flexhouse(kind), Data(rows[:, 0], rows[:, 1:4], rows[:, 4]), errors="fisher")
        program = "one program" if kind == "TiTh" else "two programs"
        yield Row("G", f"{kind}: NLL at the optimum", program, number, -r.llf, "test_g_flexhouse")
        words = values.split()
        yield from (
            Row("G", f"{kind}: {name}", program, value, r.params[name], "test_g_flexhouse")
            for name, value in zip(words[::2], words[1::2], strict=True)
        )


WRONG = (
    ("ctsmTMB", "NaN on irregular sampling with one RK4 step a sample", "C irregular, above",
     "test_identification.py::test_c_sampling_of_every_kind"),
    ("ctsmTMB", "its linear filter is silently wrong on growing steps: 66.51", "C growing, above",
     "test_identification.py::test_c_sampling_of_every_kind"),
    ("ctsmTMB", "a drift with 1/state does not build", "builds; likelihood of an independent NumPy filter",
     "test_identification.py::test_a_drift_with_one_over_a_state_builds"),
    ("ctsmTMB", "parameters on their natural scale do not finish where logarithms do", "the same optimum of E on both scales",
     "test_identification.py::test_natural_scale_ends_where_logarithms_do"),
    ("ctsmTMB", "initial states cannot be estimated", "Tw0 of F, above",
     "test_identification.py::test_f_armadillo_with_estimated_start_and_first_order_hold"),
    ("ctsmTMB", "a reloaded model crashes", "predicts the same to the bit, from plain data",
     "test_fit.py::test_plain_data_come_back_the_same"),
    ("pySIP", "wrong constant with two outputs", "B and D (two outputs), above", "test_identification.py::test_b_ctsmtmb_reference"),
    ("pySIP", "a row with one missing value is dropped whole", "joint normal density of all that was measured",
     "test_identification.py::test_a_row_with_one_missing_value_is_used"),
    ("statsmodels", "D: 91 s and not converged, -9082.9", "D optimum, above",
     "test_identification.py::test_d_ends_in_the_global_optimum_never_in_the_trap"),
    ("dynamax", "the input acts one step later", "acts on [t_k, t_k+1): A to D, above", "test_identification.py::test_b_ctsmtmb_reference"),
)  # fmt: skip

HEAD = """# Identification side by side with other programs

Written by `python docs/studies/identification_side_by_side.py`; `--check` computes every number of ours anew and compares. The other programs' numbers
come from their own runs and publications (CTSM 2.3, ctsmTMB, pySIP, dynamax, statsmodels, exact matrix-exponential filters); ours are shown to as many
digits. How long each takes: [kernels](../benchmarks/kernels.md). Tests are in `tests/greybox/`; gradients are tested, too.

"""
TABLE = "| case | what | program | theirs | ours | test |\n|---|---|---|---:|---:|---|\n"


def sections(with_real: bool) -> Iterator[tuple[str, list[str]]]:
    """Titles and rows; real records only where they are."""
    yield "Likelihoods at given parameters", [r.text() for r in (*likelihoods(), *kernels())]
    yield "Optima, estimates and standard errors", [r.text() for r in optima()]
    if with_real:
        yield "Real buildings", [r.text() for r in real()]


def wrong() -> str:
    """The table of what others get wrong."""
    rows = "\n".join(f"| {a} | {b} | {c} | {d.split('::')[1]} |" for a, b, c, d in WRONG)
    return f"## What other programs get wrong\n| program | what happens | here | test |\n|---|---|---|---|\n{rows}\n"


def page() -> str:
    """The whole page."""
    parts = [f"## {title}\n{TABLE}" + "\n".join(rows) + "\n" for title, rows in sections(True)]
    return HEAD + "\n".join([*parts, wrong()])


def check() -> list[str]:
    """Rows that the page does not have as they are computed now.

    Estimates may differ by a thousandth of their standard error, where a search on another processor stops; all else by
    three in the last digit.
    """
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    rows = [row for _, rows in sections((DATA / "armadillo_30min.csv").is_file()) for row in rows]
    return [row for row in (*rows, *wrong().splitlines()) if not any(same(row, line) for line in lines)]


def same(row: str, line: str) -> bool:
    """Whether two rows say the same, their fifth column within the allowance."""
    if row == line:
        return True
    a, b = row.split("|"), line.split("|")
    if len(a) != len(b) or len(a) != 8 or a[:5] + a[6:] != b[:5] + b[6:]:
        return False
    now, before = a[5].split(), b[5].split()
    allowed = 3.0 * 10.0 ** -decimals(now[0])
    if len(now) == 2:
        error = float(now[1].strip("()"))
        if abs(float(before[1].strip("()")) - error) > 1e-3 * error + 3.0 * 10.0 ** -decimals(now[1].strip("()")):
            return False
        allowed = max(allowed, 1e-3 * error)
    return abs(float(now[0]) - float(before[0])) <= allowed


if __name__ == "__main__":
    if "--check" in sys.argv:
        stale = check()
        print("\n".join(stale) or "every number stands as it is computed now")
        raise SystemExit(bool(stale))
    PAGE.write_text(page(), encoding="utf-8")
