// node validate.mjs FILE...: each problem on a line of its own; exit code 1 if there is any.
import { existsSync, readFileSync, writeFileSync } from "node:fs";
import { createGenerator } from "ts-json-schema-generator";
import Ajv from "ajv";

const cached = "dashboard.schema.json";
if (!existsSync(cached)) {
  const types = "node_modules/@grafana/schema/dist/esm/raw/dashboard/x/dashboard_types.gen.d.ts";
  // Unknown keys are refused, so that a typo is found.
  const config = { path: types, type: "Dashboard", skipTypeCheck: true, additionalProperties: false };
  writeFileSync(cached, JSON.stringify(createGenerator(config).createSchema("Dashboard")));
}
const validate = new Ajv({ allErrors: true, strict: false }).compile(JSON.parse(readFileSync(cached)));
let bad = 0;
for (const file of process.argv.slice(2)) {
  if (validate(JSON.parse(readFileSync(file)))) continue;
  for (const e of validate.errors) {
    console.log(`${file}: ${e.instancePath} ${e.message} ${JSON.stringify(e.params)}`);
    bad += 1;
  }
}
process.exit(bad ? 1 : 0);
