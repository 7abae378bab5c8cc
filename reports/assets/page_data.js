// What the page knows of its runs: `page_data.py` describes it.
import { inflated } from "./inflated.js";

export const pageData = JSON.parse(await inflated(document.getElementById("page-data").textContent).text());
