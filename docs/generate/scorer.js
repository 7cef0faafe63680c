// Pages come before the API reference, which has an entry for every argument and field.
const API = "generated/api/";
var Scorer = {
  score: ([page, , , , score]) => page.startsWith(API) ? score - 30 : score,
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
