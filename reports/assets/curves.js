// Any score over the horizon, with interval bands.
import { choiceBar } from "./choices.js";
import { downloadButtons } from "./downloads.js";
import { make } from "./elements.js";
import { lineChart } from "./line_chart.js";
import { pageData } from "./page_data.js";
import { curveOf, recordingNamed, recordingOptions, rowsWith, scoreNamed, scoresOf, scoreWords, strataOf } from "./scores.js";
import { whenShownChange } from "./shown_trackers.js";

// The best of the table is drawn last, on top.
function linesOf({ recording, score, stratum }) {
  return rowsWith(recordingNamed(recording), stratum, score).toReversed().map((row) => {
    const [values, low, high] = ["", "_low", "_high"].map((end) => curveOf(row, stratum, score, end));
    const style = row.group === "unranked" ? `${row.style} partial` : row.style;
    const name = row.group === "unranked" ? `${row.name} (not ranked)` : row.name;
    return { name, style, values, low, high };
  });
}

function drawCurves(chosen, width) {
  const horizons = recordingNamed(chosen.recording).horizons_s;
  return lineChart({
    xs: horizons,
    lines: linesOf(chosen),
    unit: " s",
    words: (i) => `${Number(horizons[i].toPrecision(3))} s ahead${i ? "" : ": the input, not ranked"}`,
    unranked: true,
    fromZero: chosen.score !== "beam_bias",
    width,
  });
}

function numbersOf(chosen) {
  const lines = linesOf(chosen).toReversed();
  const ends = (name, one) => [name, ...(one.low && one.high ? [`${name} low`, `${name} high`] : [])];
  const values = (one, i) => [one.values[i], ...(one.low && one.high ? [one.low[i], one.high[i]] : [])];
  return [["horizon, s", ...lines.flatMap((one) => ends(one.name, one))],
    ...recordingNamed(chosen.recording).horizons_s.map((s, i) => [s, ...lines.flatMap((one) => values(one, i))])];
}

// Fills the section of the curves.
export function startCurves() {
  const section = document.getElementById("curves");
  section.hidden = !pageData.recordings.some((one) => one.rows.some((row) => Object.keys(row.strata).length));
  const { score, stratum } = pageData.headline;
  const chosen = { recording: pageData.recordings[0].name, score, stratum };
  const holder = make("div", { class: "drawn" });
  const note = make("p", { class: "note" });
  const redraw = () => {
    holder.replaceChildren(drawCurves(chosen, Math.max(holder.clientWidth, 300)));
    const bands = holder.querySelector(".band") ? "; a band is a 95 % interval" : "; without intervals";
    note.textContent = `${scoreWords(scoreNamed(chosen.score))} over the horizon${bands}.`;
  };
  const listed = (now) => {
    const recording = recordingNamed(now.recording);
    return [["recording", "Recording", recordingOptions()], ["stratum", "Cells", strataOf(recording)],
      ["score", "Score", scoresOf(recording, now.stratum)]];
  };
  const downloads = downloadButtons("curves", () => holder.querySelector("svg"), () => numbersOf(chosen));
  section.append(make("div", { class: "controls" }, choiceBar(listed, chosen, redraw), downloads), holder, note);
  redraw();
  whenShownChange(redraw);
  let width = holder.clientWidth;
  new ResizeObserver(() => {
    if (holder.clientWidth === width) return;
    width = holder.clientWidth;
    redraw();
  }).observe(section);
}
