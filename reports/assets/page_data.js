// What the page knows of its runs: `page_data.py` describes it.
export const pageData = JSON.parse(document.getElementById("page-data").textContent);
