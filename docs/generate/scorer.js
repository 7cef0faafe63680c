// Written pages come first, then generated ones, and last the API reference with an entry for every argument and field.
const LATER = [["generated/api/", 30], ["generated/", 9]];
var Scorer = {
  score: ([page, , , , score]) => score - (LATER.find(([folder]) => page.startsWith(folder)) ?? ["", 0])[1],
  objNameMatch: 11, objPartialMatch: 6, objPrio: { 0: 15, 1: 5, 2: -5 }, objPrioDefault: 0,
  title: 15, partialTitle: 7, term: 5, partialTerm: 2,
};
