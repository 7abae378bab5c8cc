// Any score over the horizon, with interval bands.
import { inSeconds } from "./axis.js";
import { startFigure } from "./figure.js";
import { pageData } from "./page_data.js";
import {
  bandWords, curveOf, ENDS, lineOf, recordingNamed, recordingOptions, rowsWith, scoreNamed, scoresOf, scoreWords, strataOf,
} from "./scores.js";

// The best of the table is drawn last, on top.
function curveChart({ recording, score, stratum }) {
  const { horizons_s: xs } = recordingNamed(recording);
  const lines = rowsWith(recordingNamed(recording), stratum, score).toReversed().map((row) => {
    const [values, low, high] = ENDS.map((end) => curveOf(row, stratum, score, end));
    return lineOf(row, { xs, values, low, high });
  });
  const words = (s) => `${inSeconds(s)} ahead${s ? "" : ": the input, not ranked"}`;
  return { lines, x: { name: "horizon, s", unit: " s", words, unranked: true }, y: { name: scoreNamed(score).name, fromZero: score !== "beam_bias" } };
}

// Fills the section of the curves.
export function startCurves() {
  if (!pageData.recordings.some((one) => one.rows.some((row) => Object.keys(row.strata).length))) return;
  const { score, stratum } = pageData.headline;
  startFigure({
    id: "curves",
    chosen: { recording: pageData.recordings[0].name, score, stratum },
    choices: (now) => {
      const recording = recordingNamed(now.recording);
      return [["recording", "Recording", recordingOptions()], ["stratum", "Cells", strataOf(recording)],
        ["score", "Score", scoresOf(recording, now.stratum)]];
    },
    chart: curveChart,
    line: (now) => `${scoreWords(scoreNamed(now.score))} over the horizon${bandWords(curveChart(now))}.`,
  });
}
