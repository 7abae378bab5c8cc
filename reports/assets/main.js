import { startCurves } from "./curves.js";
import { startPlayers } from "./player.js";
import { startRanking } from "./ranking.js";
import { startShownTrackers } from "./shown_trackers.js";

startShownTrackers();
startRanking();
startCurves();
startPlayers();
