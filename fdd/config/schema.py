"""The tables of the site file. Every field's description is checked to stand in ``docs/site-file.md``."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, SerializeAsAny, field_validator, model_validator

from fdd.expressions import Expression, ExpressionError, compile_expression
from fdd.limits import LimitError, name_within
from fdd.tables import Duration, DurationOrZero, SourceOptions, Strict, UnitText, Zone, refusal, suggestion
from fdd.units import Conversion, QuantityKind, UnitError, conversion

CHILLER = "gordon_ng"
"""The model of equipment that is monitored as a chiller, by ``fdd.chiller_eiv``, and not by a filter."""


class Point(Strict):
    """One measured or derived point. Numbers (``sensor_sd``, ``range``, ``missing``) are in the point's ``unit``."""

    column: str = Field(
        default="", description="what the source calls it (column, topic); defaults to the point's own name"
    )
    source: str = Field(default="", description="which of several sources it comes from; defaults to the first")
    unit: UnitText = Field(default="1", description="unit as the plant spells it")
    quantity: QuantityKind | None = Field(
        default=None, description="temperature (K that are absolute) or difference (degC or degF that are differences)"
    )
    fluid: str | float | None = Field(
        default=None, description="what flows, or its density [kg/m3]; makes a volume flow a mass flow"
    )
    sensor_sd: float | None = Field(default=None, gt=0, description="standard deviation of the sensor's error")
    range: tuple[float, float] | None = Field(default=None, description="values outside are rejected as bad")
    missing: tuple[float, ...] = Field(default=(), description="numbers that mean 'no value', such as -9999")
    expression: str | None = Field(default=None, description="makes this a derived point: arithmetic over other points")
    description: str = Field(default="", description="what the point is, for the report")

    @field_validator("range")
    @classmethod
    def _ordered(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None and not value[0] < value[1]:
            raise refusal(f"range {value[0]:g} to {value[1]:g} is empty", "Write [lowest, highest].")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Point:
        if self.expression is not None and (self.column or self.source or self.missing or self.range):
            raise refusal("a derived point has no column, range or missing values", "Put them on the points it uses.")
        try:
            self.conversion  # noqa: B018 - refuses what cannot be converted
        except UnitError as error:
            key = "fluid" if error.value == self.fluid else "quantity" if self.quantity else "unit"
            raise refusal(error.statement, error.remedy, key) from None
        if self.fluid is not None and self.conversion.si != "kg/s":
            raise refusal(f"'fluid' has no use for unit {self.unit!r}", "Leave it out, or correct the unit.", "fluid")
        return self

    @property
    def conversion(self) -> Conversion:
        """From the declared unit to SI."""
        return conversion(self.unit, quantity=self.quantity, fluid=self.fluid)

    @property
    def sensor_sd_si(self) -> float | None:
        """Standard deviation of the sensor's error in SI."""
        return None if self.sensor_sd is None else self.conversion.spread(self.sensor_sd)


class ParameterSpec(Strict):
    """What is known beforehand about one parameter of a component, in the model's unit for it."""

    initial: float | None = Field(default=None, description="where estimation starts")
    lower: float | None = Field(default=None, description="lower bound")
    upper: float | None = Field(default=None, description="upper bound")
    fixed: bool = Field(default=False, description="hold it at 'initial' instead of estimating it")
    tied: str | None = Field(default=None, description="the parameter it is always equal to")
    plate: float | None = Field(default=None, gt=0, description="its value on the plate or data sheet: a prior")
    within: float = Field(
        default=3.0, gt=1, description="factor of 'plate' beyond which a fit is not put in force, two sd of the prior"
    )

    @model_validator(mode="before")
    @classmethod
    def _number(cls, table: Any) -> Any:
        if isinstance(table, int | float) and not isinstance(table, bool):
            return {"initial": table}
        return table

    @model_validator(mode="after")
    def _bounded(self) -> ParameterSpec:
        if self.fixed and self.initial is None:
            raise refusal("'fixed' needs a value", "Give it as 'initial'.", "fixed")
        low = -float("inf") if self.lower is None else self.lower
        high = float("inf") if self.upper is None else self.upper
        if low >= high:
            raise refusal(f"lower {low:g} is not below upper {high:g}", "Swap or correct them.", "lower")
        if self.initial is not None and not low <= self.initial <= high:
            raise refusal(f"initial {self.initial:g} is outside [{low:g}, {high:g}]", "Move it inside.", "initial")
        return self


class Charts(Strict):
    """Which charts watch a component; empty means all that apply."""

    kinds: tuple[Literal["day", "cusum", "score", "flatline", "health"], ...] = Field(
        default=(),
        description="kinds of chart: day (outputs, day by day), cusum (gross faults at once), score (parameters), "
        "flatline (frozen readings), health (of the model); empty means all",
    )
    exclude: tuple[str, ...] = Field(default=(), description="parameters or outputs that get no chart")


class Equipment(Strict):
    """One component under a filter."""

    model: str = Field(description="component model; `fdd models` lists them")
    options: dict[str, Any] = Field(default={}, description="options of the model")
    inputs: dict[str, str] = Field(default={}, description="model input to point")
    outputs: dict[str, str] = Field(default={}, description="model output to point")
    parameters: dict[str, ParameterSpec] = Field(default={}, description="what is known about parameters")
    when: str | None = Field(default=None, description="condition under which it may be judged, such as pump > 0.5")
    start_up: DurationOrZero = Field(default=0.0, description="how long charts rest after 'when' becomes true")
    weight: float = Field(default=1.0, gt=0, description="share of the false-alarm budget, relative to other equipment")
    upstream: tuple[str, ...] = Field(default=(), description="equipment whose alarm explains this one's")
    charts: Charts = Field(default=Charts(), description="which charts watch it")
    filter: bool = Field(
        default=False, description="a filter beside the rows of expectations, where the model has both (air_handler)"
    )
    title: str = Field(default="", description="name for people")
    location: str = Field(default="", description="where to find it")


class Rule(Strict):
    """An expectation of the site's own: an expression that is zero, or at most zero, where all is well."""

    expect: str = Field(description="expression over points that is zero, or at most zero, where all is well")
    when: str | None = Field(default=None, description="condition under which the rule holds, such as fan > 0.5")
    tolerance: float = Field(gt=0, description="what may remain for good, in 'unit': two standard deviations")
    unit: UnitText | None = Field(default=None, description="unit of the tolerance; defaults to the expression's in SI")
    side: Literal["above", "below", "either"] = Field(
        default="above", description="where the expression goes when something is wrong: above, below or either side"
    )
    held: DurationOrZero = Field(default=900.0, description="how long 'when' must have held")
    says: str = Field(default="", description="what it means when the rule is broken; defaults to its name")
    checks: tuple[str, ...] = Field(default=(), description="what to check first")
    weight: float = Field(default=1.0, gt=0, description="share of the false-alarm budget, relative to equipment")
    upstream: tuple[str, ...] = Field(default=(), description="equipment whose alarm explains this rule's")


class Tariffs(Strict):
    """Prices, for the cost of a fault."""

    currency: str = Field(default="EUR", description="currency of the prices")
    heat: float | None = Field(default=None, ge=0, description="price of heat per kWh")
    cooling: float | None = Field(default=None, ge=0, description="price of cooling per kWh")
    electricity: float | None = Field(default=None, ge=0, description="price of electricity per kWh")
    dear: float = Field(default=10.0, gt=0, description="a cost a day from which an alarm is one class more severe")
    cheap: float = Field(default=0.5, ge=0, description="a cost a day below which it is one class less severe")


class Reidentify(Strict):
    """When baselines are identified anew. Only what passes every gate is put in force."""

    every: Duration = Field(default=86400.0, description="how often, in whole days")
    at: str = Field(default="02:30", description="time of the day, in the site's zone")
    window: Duration = Field(default=28 * 86400.0, description="how far back the history reaches")
    deadband: float = Field(
        default=0.02,
        ge=0,
        le=0.2,
        description="relative change of a parameter that is left to the next baseline to follow: no chart rings for it",
    )
    approval: bool = Field(default=False, description="a person approves each new baseline: fdd baselines --approve")

    @field_validator("every")
    @classmethod
    def _whole_days(cls, value: float) -> float:
        if value % 86400.0:
            raise refusal(f"{value:g} s is no whole number of days", "Give it in days, like '1 d' or '7 d'.")
        return value

    @field_validator("at")
    @classmethod
    def _clock(cls, value: str) -> str:
        hour, colon, minute = value.partition(":")
        if not (colon and hour.isdigit() and minute.isdigit() and int(hour) < 24 and int(minute) < 60):
            raise refusal(f"{value!r} is no time of the day", 'Write it in quotes, like "02:30".')
        return value

    @property
    def time_of_day(self) -> tuple[int, int]:
        """Hour and minute."""
        hour, _, minute = self.at.partition(":")
        return int(hour), int(minute)


class Reports(Strict):
    """When reports are written, early on Monday or on the first of the month."""

    every: Literal["weekly", "monthly"] = Field(description="weekly or monthly")
    folder: Path = Field(default=Path("reports"), description="where reports go, relative to the site file")
    pdf: bool = Field(default=False, description="write a PDF beside the HTML")


class SqliteStore(Strict):
    """The embedded store."""

    kind: Literal["sqlite"] = Field(default="sqlite", description="sqlite")
    path: Path = Field(default=Path("fdd.sqlite"), description="database file, relative to the site file")


class InfluxStore(Strict):
    """An InfluxDB 2 server. The token is never in the site file."""

    kind: Literal["influx"] = Field(description="influx")
    url: str = Field(description="such as http://127.0.0.1:8086")
    org: str = Field(description="organisation")
    bucket: str = Field(description="bucket")
    token_file: Path | None = Field(default=None, description="file that holds the token")
    token_env: str | None = Field(default=None, description="environment variable that holds the token")
    ca_file: Path | None = Field(default=None, description="certificate that signed the server's, for https")

    @field_validator("url")
    @classmethod
    def _without_secrets(cls, value: str) -> str:
        if "@" in value:  # the address is printed in errors and in the log
            raise refusal("the address holds a user or a password", "Take them out; use token_file or token_env.")
        return value

    @model_validator(mode="after")
    def _one_token(self) -> InfluxStore:
        if (self.token_file is None) == (self.token_env is None):
            raise refusal("give either 'token_file' or 'token_env'", "The token itself never stands in a site file.")
        return self


Store = Annotated[SqliteStore | InfluxStore, Field(discriminator="kind")]


class Site(Strict):
    """A checked site file. Durations are in seconds."""

    name: str = Field(description="name of the site")
    zone: Zone = Field(default="UTC", description="IANA time zone of local times in the data and of the report")
    language: Literal["en", "da"] = Field(default="en", description="of alarms and of the report: English or Danish")
    step: Duration = Field(default=300.0, description="length of a frame: how often filters step")
    lateness: DurationOrZero = Field(default=600.0, description="how late a sample may come and still count")
    max_gap: Duration = Field(default=3600.0, description="a longer silence restarts a component's filter")
    learning: Duration = Field(
        default=28 * 86400.0,
        description="so much of present data teaches what a baseline leaves open",
    )
    first_fit: Duration = Field(
        default=14 * 86400.0,
        description="so much usable data equipment without a baseline records before the daemon fits its first",
    )
    max_jump: Duration = Field(
        default=7 * 86400.0, description="a sample further ahead is a clock error until confirmed"
    )
    hold: DurationOrZero = Field(default=0.0, description="how long a point's last value stands in for a missing one")
    false_alarms_per_year: float = Field(default=1.0, gt=0, description="false alarms a year, for the whole plant")
    tariffs: Tariffs = Field(default=Tariffs(), description="prices")
    store: Store = Field(default=SqliteStore(), description="where results are kept")
    reidentify: Reidentify | None = Field(default=None, description="when baselines are identified anew; unset: never")
    reports: Reports | None = Field(default=None, description="when reports are written; unset: never")
    metrics: str | None = Field(
        default=None, description="host:port where the daemon serves /metrics (Prometheus) and /health"
    )
    operator: SerializeAsAny[SourceOptions] | None = Field(
        default=None, description="Zenoh endpoint where alarms are asked for and commands are taken; unset: none"
    )
    sources: tuple[SerializeAsAny[SourceOptions], ...] = Field(default=(), description="where samples come from")
    points: dict[str, Point] = Field(default={}, description="point name to what it is")
    equipment: dict[str, Equipment] = Field(default={}, description="equipment name to what it is")
    rules: dict[str, Rule] = Field(default={}, description="rule name to an expectation of the site's own")

    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _former: tuple[tuple[str, str, str], ...] = PrivateAttr(default=())

    @property
    def former(self) -> tuple[tuple[str, str, str], ...]:
        """Former words of the file and the present ones: (where, former, present)."""
        return self._former

    @field_validator("name")
    @classmethod
    def _name(cls, value: str) -> str:
        try:
            name_within(value, "the name")
        except LimitError as error:
            raise refusal(str(error), "Give a short name.") from None
        if not value.strip(" ./"):
            raise refusal(f"{value!r} cannot be a name: files are named after the site", "Write a word.")
        return value

    @field_validator("metrics")
    @classmethod
    def _address(cls, value: str | None) -> str | None:
        if value is not None:
            host, _, port = value.rpartition(":")
            if not host or not port.isdigit() or int(port) > 65535:
                raise refusal(f"{value!r} is no address", "Write host:port, like 127.0.0.1:9464.")
        return value

    @property
    def folder(self) -> Path:
        """Folder of the site file, where relative paths start."""
        return self._folder

    def located(self, folder: Path, former: tuple[tuple[str, str, str], ...] = ()) -> Site:
        """The same site, its relative paths starting at ``folder``; ``former`` says which words were replaced."""
        site = self.model_copy()
        site._folder, site._former = folder, former
        return site

    @model_validator(mode="after")
    def _references(self) -> Site:
        for check in (self._check_sources, self._check_points, self._check_expressions, self._check_equipment):
            check()
        return self

    def _check_sources(self) -> None:
        labels = [s.label for s in self.sources]
        for i, label in enumerate(labels):
            if label in labels[:i]:
                raise refusal(f"two sources are named {label!r}", "Give each a 'name'.", f"sources.{i}")

    def _check_points(self) -> None:
        seen: dict[tuple[str, str], str] = {}
        labels = [s.label for s in self.sources]
        for name, point in self.measured.items():
            if point.source and point.source not in labels:
                raise refusal(f"no source {point.source!r}", suggestion(point.source, labels), f"points.{name}.source")
            other = seen.setdefault((point.source, self.column(name)), name)
            if other != name:
                raise refusal(
                    f"reads {self.column(name)!r}, which point {other!r} reads already",
                    f"Make it a derived point: expression: {other}.",
                    f"points.{name}.column",
                )

    def _check_expressions(self) -> None:
        try:
            self.derived  # noqa: B018 - compiles them
            for name in self.equipment:
                self.gate(name)
            for name in self.rules:
                self.rule(name)
        except ExpressionError as error:
            key = next(k for k, text in self._expression_texts() if text == error.text)
            raise refusal(error.problem, error.remedy, key) from None

    def _expression_texts(self) -> list[tuple[str, str]]:
        points = [(f"points.{n}.expression", p.expression) for n, p in self.points.items() if p.expression is not None]
        gates = [(f"equipment.{n}.when", e.when) for n, e in self.equipment.items() if e.when is not None]
        rules = [(f"rules.{n}.expect", r.expect) for n, r in self.rules.items()]
        rules += [(f"rules.{n}.when", r.when) for n, r in self.rules.items() if r.when is not None]
        return points + gates + rules

    def _check_equipment(self) -> None:
        for name in self.rules:
            if "/" in name or name in self.equipment or name in ("", "-", ".", ".."):
                raise refusal(f"{name!r} cannot be a rule's name", "Give it another, without '/'.", f"rules.{name}")
        for name, item in self.equipment.items():
            if "/" in name or name in ("", "-", ".", ".."):
                raise refusal(
                    f"{name!r} cannot be a name: series are named equipment/name and pages after equipment",
                    f"Write {name.replace('/', '-').strip('.-') or 'a word'!r}, and the full text as 'title'.",
                    f"equipment.{name}",
                )
            for table in ("inputs", "outputs"):
                for role, point in getattr(item, table).items():
                    if point not in self.points:
                        raise refusal(
                            f"no point is named {point!r}",
                            suggestion(point, list(self.points)),
                            f"equipment.{name}.{table}.{role}",
                        )
            for other in item.upstream:
                if other not in self.equipment or other == name:
                    others = [e for e in self.equipment if e != name]
                    raise refusal(
                        f"no other equipment is named {other!r}",
                        suggestion(other, others),
                        f"equipment.{name}.upstream",
                    )

    @property
    def weights(self) -> float:
        """Sum of the weights that the budget of false alarms is divided by."""
        return sum(e.weight for e in self.equipment.values()) + sum(r.weight for r in self.rules.values())

    @property
    def measured(self) -> dict[str, Point]:
        """Points that come from a source."""
        return {n: p for n, p in self.points.items() if p.expression is None}

    def column(self, point: str) -> str:
        """What the source calls a point."""
        return self.points[point].column or point

    def points_of(self, source: SourceOptions) -> dict[str, Point]:
        """Measured points that come from one source; those that name none come from the first."""
        first = not self.sources or source.label == self.sources[0].label
        return {n: p for n, p in self.measured.items() if p.source == source.label or (first and not p.source)}

    @cached_property
    def units(self) -> Mapping[str, str]:
        """SI unit of every point, measured and derived."""
        return {n: p.conversion.si for n, p in self.measured.items()} | {n: e.unit for n, e in self.derived.items()}

    @cached_property
    def derived(self) -> Mapping[str, Expression]:
        """Derived points in an order in which each needs only those before it."""
        units = {n: p.conversion.si for n, p in self.measured.items()}
        waiting = {n: p for n, p in self.points.items() if p.expression is not None}
        done: dict[str, Expression] = {}
        while waiting:
            before, failed = len(waiting), list[ExpressionError]()
            for name, point in list(waiting.items()):
                try:
                    done[name] = _derived(point, units)
                except ExpressionError as error:
                    failed.append(error)
                else:
                    units[name] = done[name].unit
                    del waiting[name]
            if waiting and len(failed) == before:
                raise _root_cause(failed, waiting)
        return done

    def gate(self, equipment: str) -> Expression | None:
        """When a piece of equipment may be judged; None means always."""
        text = self.equipment[equipment].when
        return None if text is None else compile_expression(text, self.units)

    def rule(self, name: str) -> tuple[Expression, Expression | None]:
        """What a rule expects to be zero, and when."""
        rule = self.rules[name]
        when = None if rule.when is None else compile_expression(rule.when, self.units)
        return compile_expression(rule.expect, self.units), when


def _derived(point: Point, units: Mapping[str, str]) -> Expression:
    text = point.expression or ""
    compiled = compile_expression(text, units)
    declared = point.conversion.si
    if "unit" in point.model_fields_set and compiled.unit != declared:
        problem = f"the result is in {compiled.unit}, which does not fit unit {point.unit!r}"
        raise ExpressionError(text, problem, "Correct the unit or the expression.")
    return compiled


def _root_cause(failed: list[ExpressionError], waiting: Mapping[str, Point]) -> ExpressionError:
    """The error that does not merely come of another derived point's error."""
    for error in failed:
        if not any(f"named {name!r}" in error.problem for name in waiting):
            return error
    circle = ", ".join(waiting)
    return ExpressionError(
        failed[0].text, f"derived points need each other in a circle ({circle})", "Break the circle."
    )
