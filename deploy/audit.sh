#!/usr/bin/env bash
# Known vulnerabilities of the locked requirements, an SBOM (CycloneDX) and the licences of what is installed, by
# pip-audit, cyclonedx-bom and pip-licenses in an environment of their own: var/audit/{audit.json,sbom.json,licences.csv}.
# Ends with 1 where a vulnerability is known. A package that could not be looked up is no safe package: how many there
# are is said, and with AUDIT_STRICT=1 they end it with 1, too.
set -euo pipefail
cd "$(dirname "$0")/.."
python=${1:-.venv/bin/python}
out=var/audit
mkdir -p "$out"
[ -x "$out/tools/bin/pip-audit" ] || {
    "$python" -m venv "$out/tools"
    "$out/tools/bin/pip" install --quiet --disable-pip-version-check 'pip-audit>=2.7' 'cyclonedx-bom>=5' 'pip-licenses>=5'
}
"$out/tools/bin/cyclonedx-py" environment "$python" --of JSON -o "$out/sbom.json"
"$out/tools/bin/pip-licenses" --python "$python" --format=csv >"$out/licences.csv"
"$out/tools/bin/pip-audit" --disable-pip --require-hashes -r requirements.lock --timeout 15 -f json -o "$out/audit.json" ||
    echo "pip-audit ended with $?"
"$python" - "$out" "${AUDIT_STRICT:-0}" <<'PYTHON'
import csv, json, pathlib, sys

out, strict = pathlib.Path(sys.argv[1]), sys.argv[2] == "1"
sbom = json.loads((out / "sbom.json").read_text())
licences = list(csv.DictReader((out / "licences.csv").open()))
unknown = [r["Name"] for r in licences if r["License"] in ("UNKNOWN", "")]
print(f"SBOM: CycloneDX {sbom['specVersion']}, {len(sbom['components'])} components ({out / 'sbom.json'})")
print(f"licences: {len(licences)} packages ({out / 'licences.csv'}); not declared: {', '.join(unknown) or 'none'}")
try:
    found = json.loads((out / "audit.json").read_text())["dependencies"]
except (OSError, ValueError):
    sys.exit("NOT AUDITED: pip-audit gave no result; its database cannot be reached from here")
skipped = [d["name"] for d in found if "skip_reason" in d]
weak = {d["name"]: [v["id"] for v in d["vulns"]] for d in found if d.get("vulns")}
print(f"audited: {len(found) - len(skipped)} of {len(found)} packages; vulnerable among these: {weak or 'none'}")
if skipped:
    print(f"NOT AUDITED: {len(skipped)} packages that the vulnerability database did not answer for, such as "
          f"{', '.join(skipped[:5])}; run this again where it can be reached")
sys.exit(1 if weak or (strict and skipped) else 0)
PYTHON
