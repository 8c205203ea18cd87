// Answers queries as the search box of the site does: it runs the site's own search worker.
// node search_site.js SITE QUERIES.json prints for each query the pages in the order of the hits,
// and the queries that the worker answered with an error instead.
const fs = require("fs");
const path = require("path");

const [site, queries] = [process.argv[2], JSON.parse(fs.readFileSync(process.argv[3], "utf-8"))];
const workers = path.join(site, "assets", "javascripts", "workers");
const worker = fs.readdirSync(workers).find((name) => /^search\..*\.js$/.test(name));
const index = JSON.parse(fs.readFileSync(path.join(site, "search", "search_index.json"), "utf-8"));

// The worker hides an error from the reader: it warns, and answers that there are no hits.
let warned = 0;
console.warn = () => { warned += 1; };

let receive;
let answer;
globalThis.self = globalThis;
globalThis.addEventListener = (_, listener) => { receive = listener; };
globalThis.postMessage = (message) => { answer(message); };
(0, eval)(fs.readFileSync(path.join(workers, worker), "utf-8"));

function ask(type, data) {
  return new Promise((resolve) => { answer = resolve; receive({ data: { type, data } }); });
}

(async () => {
  await ask(0, { ...index, options: { suggest: false } });
  const pages = {};
  const errors = [];
  for (const query of queries) {
    warned = 0;
    const { data } = await ask(2, query);
    if (warned) errors.push(query);
    pages[query] = data.items.map((hits) => hits.find((hit) => !hit.location.includes("#")).location);
  }
  process.stdout.write(JSON.stringify({ pages, errors }));
})();
