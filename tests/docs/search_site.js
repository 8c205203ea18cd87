// Answers queries as the search box of the site does: it runs the site's own search worker.
// node search_site.js SITE QUERIES.json prints for each query the pages in the order of the hits.
const fs = require("fs");
const path = require("path");

const [site, queries] = [process.argv[2], JSON.parse(fs.readFileSync(process.argv[3], "utf-8"))];
const workers = path.join(site, "assets", "javascripts", "workers");
const worker = fs.readdirSync(workers).find((name) => /^search\..*\.js$/.test(name));
const index = JSON.parse(fs.readFileSync(path.join(site, "search", "search_index.json"), "utf-8"));

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
  for (const query of queries) {
    const { data } = await ask(2, query);
    pages[query] = data.items.map((hits) => hits.find((hit) => !hit.location.includes("#")).location);
  }
  console.log(JSON.stringify(pages));
})();
