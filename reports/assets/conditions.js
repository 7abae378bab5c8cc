// F1 under other conditions: at higher rates of frames, and on degraded input.
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import { lineOf, recordingNamed, recordingOptions } from "./scores.js";
import { isShown } from "./shown_trackers.js";

const kindsOf = (recording) => [...new Set(recording.rows.flatMap((row) => Object.keys(row.conditions)))];

function rowsUnder({ recording, kind }) {
  return recordingNamed(recording).rows.filter((row) => isShown(row.label) && row.conditions[kind]).toReversed();
}

function conditionChart(chosen) {
  const { kind, stratum } = chosen;
  const { name, unit } = pageData.conditions[kind];
  const axis = unit ? `${name},${unit}` : name;
  const lines = rowsUnder(chosen).map((row) => {
    const { values: xs, f1, notes } = row.conditions[kind];
    return lineOf(row, { xs, values: f1[stratum] ?? xs.map(() => null), notes });
  });
  const places = [...new Set(lines.flatMap((one) => one.xs))].sort((a, b) => a - b);
  const isUntimed = (value) => kind === "rate" && value === 0;
  const number = (value) => (kind === "rate" ? `×${value}` : Number(value.toPrecision(3)));
  const text = (value) => (isUntimed(value) ? "untimed" : `${number(value)}${unit}`);
  return {
    lines,
    x: {
      name: axis, ticks: places.map((place) => [place, text(place)]), words: (place) => `${name} ${text(place)}`,
      written: (value) => (isUntimed(value) ? text(value) : value),
    },
    y: { name: "F1", fromZero: true },
  };
}

// Fills the section of other conditions.
export function startConditions() {
  const listed = recordingOptions((recording) => kindsOf(recording).length);
  if (!listed.length) return;
  const [recording] = listed[0];
  startFigure({
    id: "conditions",
    title: "Deadline and degraded input",
    chosen: { recording, kind: kindsOf(recordingNamed(recording))[0], stratum: pageData.headline.stratum },
    choices: (now) => {
      const kinds = kindsOf(recordingNamed(now.recording));
      const row = recordingNamed(now.recording).rows.find((one) => one.conditions[now.kind]);
      return [["recording", "Recording", listed], ["kind", "Condition", kinds.map((kind) => [kind, pageData.conditions[kind].name])],
        ["stratum", "Cells", Object.keys(row?.conditions[now.kind].f1 ?? {}).map((name) => [name, `${name} cells`])]];
    },
    chart: conditionChart,
    fixed: (now) => ({ score: "f1", "horizon, s": recordingNamed(now.recording).conditions_ahead_s }),
    line: ({ recording: name, kind }) => `F1 ${recordingNamed(name).conditions_ahead} ahead; ${pageData.conditions[kind].name}: ${pageData.conditions[kind].meaning}.`,
  });
}
