"""The site file: what is accepted, what is refused, and that every refusal has its line and a remedy."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel, ValidationError

from fdd.config import (
    Charts,
    ConfigError,
    Equipment,
    InfluxStore,
    ParameterSpec,
    Point,
    Reidentify,
    Reports,
    Rule,
    Site,
    SqliteStore,
    Tariffs,
    check_site,
    component_model,
    load_site,
    parse_site,
    with_data,
)
from fdd.config.chiller import chiller_config
from fdd.service.site.plan import plan_of
from ingest.csv import CsvOptions
from ingest.source import kinds, options_type, register
from ingest.trust import Publisher
from ingest.zenoh import OperatorOptions
from ingest.zenoh.options import Person

ROOT = Path(__file__).resolve().parents[1]

TWELVE_LINES = """
name: My heat exchanger
source: {kind: csv, path: data.csv}
points:
  T1: {column: "Supply hot", unit: °F}
  T2: {column: "Return hot", unit: °F}
  T3: {column: "Supply cold", unit: °F}
  T4: {column: "Return cold", unit: °F}
  q1: {column: "Flow hot", unit: gpm, fluid: water at 70 degC}
  q2: {column: "Flow cold", unit: gpm, fluid: water}
equipment:
  hx: {model: heat_exchanger, inputs: {T_hot_in: T1, T_cold_in: T3, m_flow_hot: q1, m_flow_cold: q2},
       outputs: {T_hot_out: T2, T_cold_out: T4}}
"""


def test_twelve_lines_are_enough_for_a_strangers_csv() -> None:
    site = parse_site(TWELVE_LINES)
    assert len(TWELVE_LINES.strip().splitlines()) == 12
    assert [f for f in check_site(site) if f.severity == "error"] == []
    assert site.step == 300
    assert site.units["q1"] == "kg/s"
    assert isinstance(site.store, SqliteStore)


@pytest.mark.parametrize(
    ("text", "line", "key", "says"),
    [
        ("name: x\nzon: UTC\n", 2, "zon", "Did you mean 'zone'"),
        ("name: x\npoints:\n  a:\n    unitt: K\n", 4, "points.a.unitt", "Did you mean 'unit'"),
        ("name: x\npoints:\n  a: {unit: furlongg}\n", 3, "points.a.unit", "not known"),
        ("name: x\npoints:\n  a: {unit: kW, fluid: water}\n", 3, "points.a.fluid", "has no use"),
        ("name: x\npoints:\n  a: {unit: l/s, fluid: beer}\n", 3, "points.a.fluid", "glycol"),
        ("name: x\npoints:\n  a: {unit: %}\n", 3, "", "in quotes"),
        ("name: x\nname: y\n", 2, "", "Keep one"),
        ("name: x\npoints:\n  a: {range: [5, 1]}\n", 3, "points.a.range", "lowest, highest"),
        ('name: x\nreidentify: {at: "25:00"}\n', 2, "reidentify.at", "02:30"),
        ("name: x\nreidentify: {every: 36 h}\n", 2, "reidentify.every", "'1 d'"),
        ("name: x\nreports: {every: daily}\n", 2, "reports.every", "weekly"),
        ("name: x\nequipment:\n  ahu/coil: {model: zone}\n", 3, "equipment.ahu/coil", "Write 'ahu-coil'"),
        ("name: x\nmetrics: here\n", 2, "metrics", "127.0.0.1:9464"),
        ("name: x\nstep: 5\n", 2, "step", "'5 min'"),
        ("name: x\nstep: -5 min\n", 2, "step", "not positive"),
        ("name: x\nzone: Mars/Base\n", 2, "zone", "IANA"),
        ("zone: UTC\n", 1, "name", "missing"),
        ("- x\n", 1, "", "name: My building"),
        ("name: x\n  zone: UTC\n", 2, "", "indentation"),
        ("name: x\nsource:\n  kind: cvs\n", 3, "source.kind", "Did you mean 'csv'"),
        ("name: x\nsource:\n  path: a.csv\n", 2, "source", "no 'kind'"),
        ("name: x\nsources:\n  - kind: csv\n    path: a\n  - kind: csv\n    pth: b\n", 6, "sources.1.pth", "'path'"),
        (
            "name: x\nsources:\n  - {kind: csv, path: a}\n  - {kind: csv, path: b}\n",
            4,
            "sources.1",
            "Give each a 'name'",
        ),
        (
            "name: x\nsource: {kind: csv, path: a, time: {column: t, start: 2020-01-01}}\n",
            2,
            "source.time.start",
            "Keep one",
        ),
        ("name: x\nsource: {kind: csv, path: a, header: false}\n", 2, "source.columns", "name every column"),
        ("name: x\nsource: {kind: zenoh}\n", 2, "source.key", "connect"),
        ("name: x\npoints:\n  a: {}\n  b: {column: a}\n", 4, "points.b.column", "expression: a"),
        ("name: x\npoints:\n  a.b: {unit: degC}\n  c: {expression: a.b * 2}\n", 4, "points.c.expression", "difference"),
        (
            "name: x\npoints:\n  a: {unit: W}\n  c: {unit: K, expression: a * 2}\n",
            4,
            "points.c.expression",
            "result is in W",
        ),
        ("name: x\npoints:\n  c: {expression: d * 2}\n  d: {expression: c * 2}\n", 3, "points.c.expression", "circle"),
        ("name: x\npoints:\n  a: {source: other}\n", 3, "points.a.source", "no source 'other'"),
        (
            "name: x\npoints:\n  Tin: {}\nequipment:\n  e:\n    model: m\n    inputs: {T: Ti}\n",
            7,
            "equipment.e.inputs.T",
            "'Tin'",
        ),
        ("name: x\nequipment:\n  e:\n    model: m\n    when: a >\n", 5, "equipment.e.when", "not understood"),
        ("name: x\nequipment:\n  e: {model: m, upstream: [f]}\n", 3, "equipment.e.upstream", "no other equipment"),
        (
            "name: x\nequipment:\n  e: {model: m, parameters: {U: {lower: 2, upper: 1}}}\n",
            3,
            "equipment.e.parameters.U.lower",
            "Swap",
        ),
        (
            "name: x\nequipment:\n  e: {model: m, parameters: {U: {fixed: true}}}\n",
            3,
            "equipment.e.parameters.U.fixed",
            "initial",
        ),
        ("name: x\nfalse_alarms_per_year: 0\n", 2, "false_alarms_per_year", "greater than 0"),
        ("name: x\nstore:\n  kind: influx\n  url: u\n  org: o\n  bucket: b\n", 3, "store", "token_file"),
        ("name: x\nstore: {kind: mysql}\n", 2, "store", "'sqlite', 'influx'"),
        ("name: x\nsource: {kind: csv, path: a}\nsources: []\n", 2, "source", "Keep 'sources'"),
    ],
)
def test_mistake_is_refused_with_its_line_key_and_remedy(text: str, line: int, key: str, says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_site(text, file="plant.yaml")
    error = caught.value
    assert error.key == key
    assert says in f"{error.problem} {error.remedy}"
    assert str(error).startswith(f"plant.yaml, line {error.line}: ")
    assert abs(error.line - line) <= (1 if key in {"store", ""} else 0), str(error)


def test_every_mistake_of_a_file_is_told_at_once() -> None:
    with pytest.raises(ConfigError) as caught:
        parse_site("name: x\nstep: 5\npoints:\n  a: {unit: foo}\n  b: {unitt: K}\n")
    assert [e.line for e in (caught.value, *caught.value.others)] == [2, 4, 5]
    assert len(str(caught.value).splitlines()) == 3


def test_missing_file_is_a_config_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_site(tmp_path / "nothing.yaml")


def test_site_is_frozen() -> None:
    site = parse_site("name: x\n")
    with pytest.raises(ValidationError):
        site.name = "y"  # type: ignore[misc]


def test_derived_points_come_in_an_order_that_can_be_computed() -> None:
    site = parse_site(
        "name: x\npoints:\n  heat: {expression: '4186 [J/(kg*K)] * flow * lift', unit: kW}\n"
        "  lift: {expression: hot - cold}\n  hot: {unit: degF}\n  cold: {unit: degF}\n  flow: {unit: kg/s}\n"
    )
    assert list(site.derived) == ["lift", "heat"]
    assert site.units["heat"] == "W"


def test_sensor_error_is_converted_without_the_offset() -> None:
    site = parse_site("name: x\npoints:\n  a: {unit: degF, sensor_sd: 0.9}\n")
    assert site.points["a"].sensor_sd_si == pytest.approx(0.5)


def test_relative_paths_start_at_the_site_file(tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    path.write_text("name: x\n")
    assert load_site(path).folder == tmp_path


def test_a_data_file_takes_the_place_of_the_sources() -> None:
    site = parse_site(
        "name: x\nsources:\n  - {kind: zenoh, name: bms, connect: [tcp/127.0.0.1:1]}\npoints:\n  a: {source: bms}\n"
    )
    replayed = with_data(site, "history.csv.gz")
    (source,) = replayed.sources
    assert isinstance(source, CsvOptions)
    assert source.path == Path("history.csv.gz").resolve()
    assert list(replayed.points_of(source)) == ["a"]
    assert with_data(site, "history.parquet").sources[0].kind == "parquet"


def test_a_data_file_keeps_the_sites_file_options() -> None:
    site = parse_site("name: x\nsource: {kind: csv, path: a.csv, decimal: ',', time: {column: t, day_first: true}}\n")
    (source,) = with_data(site, "b.csv").sources
    assert isinstance(source, CsvOptions)
    assert (source.decimal, source.time.day_first) == (",", True)


class TestCheck:
    def findings(self, change: tuple[str, str]) -> list[str]:
        return [str(f) for f in check_site(parse_site(TWELVE_LINES.replace(*change)))]

    def test_role_that_the_model_does_not_have(self) -> None:
        found = self.findings(("T_hot_in: T1", "T_hot_inn: T1"))
        assert any("T_hot_inn: the model has no such role. Did you mean 'T_hot_in'?" in f for f in found)
        assert any("role T_hot_in" in f and "has no point" in f for f in found)

    def test_unit_that_does_not_fit_the_role(self) -> None:
        (found,) = (f for f in self.findings(("unit: gpm, fluid: water}", "unit: gpm}")) if f.startswith("error"))
        assert "equipment.hx.inputs.m_flow_cold" in found
        assert "volume flow" in found
        assert "fluid: water" in found

    def test_difference_where_a_temperature_is_needed(self) -> None:
        (found,) = (
            f for f in self.findings(('"Supply hot", unit: °F', '"Supply hot", unit: K')) if f.startswith("error")
        )
        assert "quantity: temperature" in found

    def test_unknown_model_and_option(self) -> None:
        assert "unknown model" in self.findings(("model: heat_exchanger", "model: heat_exchangr"))[0]
        assert "no option" in self.findings(("heat_exchanger,", "heat_exchanger, options: {compartmnts: 2},"))[0]

    def test_unknown_parameter_and_one_out_of_bounds(self) -> None:
        site = parse_site(TWELVE_LINES)
        model = component_model(site.equipment["hx"])
        known = model.parameters[0]
        table = f"{{{known.symbol}: {{initial: {known.upper * 1e6}}}, Nope: 3}}"
        found = self.findings(("heat_exchanger,", f"heat_exchanger, parameters: {table},"))
        assert any("outside the model's" in f for f in found)
        assert any("Nope: the model has no such parameter" in f for f in found)

    def test_unused_point_is_a_warning(self) -> None:
        found = self.findings(("equipment:", "  spare: {unit: kW}\nequipment:"))
        assert found == ["warning: points.spare: is used by no equipment. Map it to a role, or leave it out."]

    def test_fixed_and_tied_parameters_leave_the_model(self) -> None:
        site = parse_site(TWELVE_LINES)
        free = component_model(site.equipment["hx"])
        symbol, value = free.parameters[0].symbol, free.parameters[0].typical
        held = Equipment.model_validate(
            {"model": "heat_exchanger", "parameters": {symbol: {"initial": value, "fixed": True}}}
        )
        assert len(component_model(held).parameters) == len(free.parameters) - 1


CHILLER = """
name: Plant
tariffs: {{currency: USD, electricity: 0.12}}
source: {{kind: csv, path: data.csv}}
false_alarms_per_year: 0.2
points:
  EWT: {{unit: degF, sensor_sd: 0.18}}
  LWT: {{unit: degF, sensor_sd: 0.18}}
  CWT: {{unit: degF, sensor_sd: 0.36}}
  flow: {{unit: gpm, fluid: water}}
  kW: {{unit: kW}}
equipment:
  c1:
    model: gordon_ng
    inputs: {{T_chi: EWT, T_cho: LWT, T_cdi: CWT, flow_ch: {flow}, {power}: kW}}
    {more}
    options:
      rated_load: {rated}
      errors: {{{errors}}}
"""
SOUND = {
    "flow": "flow",
    "power": "power",
    "more": "title: Chiller",
    "rated": "1.7e6",
    "errors": "flow_ch: {relative: 0.01}, power: {relative: 0.01}",
}


def test_a_chillers_declaration_takes_errors_price_and_budget_from_the_site() -> None:
    site = parse_site(CHILLER.format(**SOUND))
    assert check_site(site) == []
    config = chiller_config(site, "c1")
    assert config.instruments.errors["T_chi"].random == pytest.approx(0.1)
    assert config.instruments.errors["T_cdi"].random == pytest.approx(0.2)
    assert config.instruments.errors["flow_ch"].relative == 0.01
    assert config.price == 0.12
    assert config.currency == "USD"
    # 0.15 of weekly and 0.25 of daily charts are cut to the site's 0.2, each in proportion.
    assert config.drift.false_alarms + config.residual_false_alarms == pytest.approx(0.2)
    assert config.drift.false_alarms == pytest.approx(0.2 * 0.15 / 0.4)


def test_a_chiller_takes_its_share_of_the_plants_budget() -> None:
    text = TWELVE_LINES.replace("equipment:", "  kW: {unit: kW}\nequipment:").rstrip() + "\n  c1:\n    weight: 3\n"
    text += "    model: gordon_ng\n    inputs: {T_cdi: T1, T_chi: T2, T_cho: T3, flow_ch: q1, power: kW}\n"
    text += "    options: {rated_load: 1e6, errors: {T_cdi: {random: 0.1}, T_chi: {random: 0.1}, T_cho: {random: 0.1},"
    text += " flow_ch: {relative: 0.01}, power: {relative: 0.01}}}\n"
    site = parse_site(text)
    assert [f for f in check_site(site) if f.severity == "error"] == []
    plan = plan_of(site)
    assert (plan.false_alarms_per_year, plan.filters_per_year) == (1.0, pytest.approx(0.25))
    (chiller,) = plan.chillers
    assert [c.name for c in plan.components] == ["hx"]
    assert chiller.config.drift.false_alarms + chiller.config.residual_false_alarms <= 0.75


@pytest.mark.parametrize(
    ("change", "key", "says"),
    [
        ({"power": "powr"}, "equipment.c1.inputs.powr", "no such role"),
        ({"power": "load"}, "equipment.c1", "role power (electrical power) has no point"),
        ({"flow": "kW"}, "equipment.c1.inputs.flow_ch", "[kg/s]"),
        ({"errors": "power: {relative: 0.01}"}, "equipment.c1.options.errors", "sensor error of flow_ch"),
        ({"errors": "power: {relativ: 0.01}"}, "equipment.c1.options", "unknown key 'relativ'"),
        ({"rated": "-1"}, "equipment.c1.options", "rated_load must be positive"),
        ({"rated": "big"}, "equipment.c1.options", "chiller 'c1'"),
        ({"rated": "1e6\n      speed: fast"}, "equipment.c1.options", "speed must be one of fixed, measured, by load"),
        ({"rated": "1e6\n      rated_laod: 1"}, "equipment.c1.options", "did you mean 'rated_load'"),
        ({"more": "start_up: 5 min"}, "equipment.c1.start_up", "settling"),
        ({"more": "outputs: {T_cdo: CWT}"}, "equipment.c1.outputs", "under 'inputs'"),
        ({"rated": "1e6\n      residual_false_alarms: 2"}, "equipment.c1.options", "its share of the site's is 0.2"),
    ],
)
def test_a_wrong_chiller_is_found_with_a_remedy(change: dict[str, str], key: str, says: str) -> None:
    found = [f for f in check_site(parse_site(CHILLER.format(**{**SOUND, **change}))) if f.key == key]
    assert any(says in str(f) for f in found), found


def test_a_kind_of_source_is_registered_once() -> None:
    with pytest.raises(ValueError, match="already registered by ingest"):
        register("csv", "somewhere:Else")


# The reference


def _tables() -> Iterator[tuple[str, type[BaseModel]]]:
    own = [Site, Point, Equipment, ParameterSpec, Rule, Charts, Tariffs, Reidentify, Reports, SqliteStore, InfluxStore]
    yield from ((t.__name__, t) for t in own)
    yield "operator", OperatorOptions
    yield "operator person", Person
    yield "publisher", Publisher
    for kind in kinds():
        options = options_type(kind)
        yield kind, options
        for field in options.model_fields.values():
            for part in (field.annotation, *get_args(field.annotation)):
                if isinstance(part, type) and issubclass(part, BaseModel):
                    yield f"{kind} {part.__name__}", part


REFERENCE = ROOT / "docs" / "site-file.md"


@pytest.mark.parametrize(("name", "table"), list(_tables()))
def test_every_key_is_documented_with_its_meaning(name: str, table: type[BaseModel]) -> None:
    text = REFERENCE.read_text(encoding="utf-8")
    for key, field in table.model_fields.items():
        row = f"| `{key}` |"
        assert field.description, f"{name}.{key} has no description"
        assert any(row in line and field.description in line for line in text.splitlines()), (
            f"docs/site-file.md has no row for {name}: {row} ... | {field.description} |"
        )


def test_documented_keys_exist() -> None:
    known = {key for _, table in _tables() for key in table.model_fields}
    documented = set(re.findall(r"^\| `(\w+)` \|", REFERENCE.read_text(encoding="utf-8"), flags=re.MULTILINE))
    assert documented - known == set()


@pytest.mark.parametrize("number", range(8))
def test_example_in_the_reference_loads(number: int) -> None:
    examples = re.findall(r"```yaml\n(.*?)```", REFERENCE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(examples) == 8
    site = parse_site(examples[number])
    assert [f for f in check_site(site) if f.severity == "error"] == []
