// Scores over the side of a neighbourhood, and over the time since a cell was last seen.
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import {
  aheadChoice, bandWords, ENDS, lineOf, recordingNamed, recordingOptions, rowsWith, scoreNamed, scoresOf, scoreWords,
  stepAt, strataOf, valueAt,
} from "./scores.js";

const SCALES = [1, 3, 5, 9];
const HIDDEN = /^occluded (?:to|over|[\d.]+-)/;
const hasScale = (recording) => recording.rows.some((row) => Object.values(row.strata).some((one) => one.fss_1));
const agesOf = (recording) => strataOf(recording, (name) => HIDDEN.test(name)).map(([name]) => name);

function scaleChart(chosen) {
  const { recording, stratum } = chosen, step = stepAt(chosen);
  const lines = rowsWith(recordingNamed(recording), stratum, "fss_1").toReversed().map((row) => {
    const [values, low, high] = ENDS.map((end) => SCALES.map((scale) => valueAt(row, stratum, `fss_${scale}`, step, end)));
    return lineOf(row, { xs: SCALES, values, low, high });
  });
  const { cell_m: cell } = recordingNamed(recording);
  const text = (scale) => (cell ? `${scale} (${Number((scale * cell).toPrecision(2))} m)` : String(scale));
  return {
    lines,
    x: { name: "side in cells", ticks: SCALES.map((scale) => [scale, text(scale)]), words: (scale) => `${text(scale)} cells` },
    y: { name: "FSS", range: [0, 1.02] },
  };
}

// Fills the section of the fractions skill score over the scale.
export function startScale() {
  const listed = recordingOptions(hasScale);
  if (!listed.length) return;
  const { stratum, ahead_s } = pageData.headline;
  startFigure({
    id: "scale",
    title: "Scale",
    chosen: { recording: listed[0][0], stratum, ahead_s },
    choices: (now) => {
      const recording = recordingNamed(now.recording);
      const scaled = strataOf(recording, (name) => recording.rows.some((row) => row.strata[name]?.fss_1));
      return [["recording", "Recording", listed], ["stratum", "Cells", scaled], aheadChoice(now)];
    },
    chart: scaleChart,
    fixed: () => ({ score: "fss" }),
    line: (now) => `Fractions skill score over the side of a neighbourhood${bandWords(scaleChart(now))}.`,
  });
}

function hiddenChart(chosen) {
  const { recording, score } = chosen, step = stepAt(chosen);
  const ages = agesOf(recordingNamed(recording)), xs = ages.map((_, i) => i);
  const lines = rowsWith(recordingNamed(recording), ages[0], score).toReversed().map((row) => {
    const [values, low, high] = ENDS.map((end) => ages.map((stratum) => valueAt(row, stratum, score, step, end)));
    return lineOf(row, { xs, values, low, high });
  });
  const text = (i) => ages[i].replace("occluded ", "");
  return {
    lines,
    x: {
      name: "time since the cell was last seen", range: [0, Math.max(ages.length - 1, 1)],
      ticks: xs.map((i) => [i, text(i)]), words: (i) => `unseen for ${text(i)}`, written: text,
    },
    y: { name: scoreNamed(score).name, fromZero: true },
  };
}

// Fills the section of hidden cells, by the time since they were seen.
export function startHiddenTime() {
  const listed = recordingOptions((recording) => agesOf(recording).length > 1);
  if (!listed.length) return;
  startFigure({
    id: "hidden-time",
    title: "Hidden cells",
    chosen: { recording: listed[0][0], score: "f1", ahead_s: pageData.headline.ahead_s },
    choices: (now) => {
      const recording = recordingNamed(now.recording);
      return [["recording", "Recording", listed], ["score", "Score", scoresOf(recording, agesOf(recording)[0])],
        aheadChoice(now)];
    },
    chart: hiddenChart,
    line: (now) => `${scoreWords(scoreNamed(now.score))} of cells that no beam reached, by the time since then${bandWords(hiddenChart(now))}.`,
  });
}
