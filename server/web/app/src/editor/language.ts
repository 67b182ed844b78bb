// TOML whose strings are formulas, for the editor: colours, and the names that can be completed.
import type { CompletionContext, CompletionResult } from "@codemirror/autocomplete";
import { HighlightStyle, StreamLanguage, type StringStream } from "@codemirror/language";
import { tags } from "@lezer/highlight";

const FUNCTIONS = [
  "sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "erf", "erfc", "sinc", "bessel_j0",
  "bessel_j1", "abs", "atan2", "min", "max", "if", "piecewise", "sum", "product", "table",
];
const WORDS = ["and", "or", "not", "pi"];
const KEYS = [
  "name", "description", "coordinates", "channels", "[parameters]", "[roles]", "[constants]", "[definitions]", "[model]", "[[stages]]",
  "start", "min", "max", "unit", "centre", "shape", "background", "brightness", "intensity", "observed", "domain", "constraint", "noise",
  "saturated", "quadrature", "loss", "deviation", "method", "iterations", "tolerance", "parameters",
];

interface State { quote: string; table: string }

/** In other tables strings are words: names, units, methods. */
function isFormula(state: State): boolean {
  return state.table === "definitions" || state.table === "model";
}

function formula(stream: StringStream, state: State): string | null {
  if (stream.match(state.quote)) {
    state.quote = "";
    return "string";
  }
  if (!isFormula(state)) {
    stream.next();
    return "string";
  }
  if (stream.match(/^(\d+\.?\d*|\.\d+)(e[+-]?\d+)?/i)) return "number";
  const word = stream.match(/^[\p{L}_][\p{L}\p{N}_]*/u) as RegExpMatchArray | null;
  if (word) {
    if (WORDS.includes(word[0])) return "keyword";
    return stream.match(/^\s*\(/, false) ? "function" : "variable";
  }
  stream.next();
  return "operator";
}

/** Text after `#` is a comment, the left of `=` a key, and what stands in quotes a formula. */
export const language = StreamLanguage.define<State>({
  name: "model",
  startState: () => ({ quote: "", table: "" }),
  token(stream, state) {
    if (state.quote) return formula(stream, state);
    if (stream.eatSpace()) return null;
    if (stream.match(/^#.*/)) return "comment";
    const heading = stream.sol() ? stream.match(/^\s*\[\[?([^\]]*)\]\]?/) as RegExpMatchArray | null : null;
    if (heading) {
      state.table = heading[1]!.trim();
      return "heading";
    }
    const key = stream.match(/^("[^"]*"|[\w-]+)(?=\s*=)/);
    if (key) return "property";
    const quote = stream.match(/^("""|'''|"|')/) as RegExpMatchArray | null;
    if (quote) {
      state.quote = quote[0];
      return "string";
    }
    if (stream.match(/^[+-]?(\d[\d_]*\.?\d*|\.\d+)(e[+-]?\d+)?/i)) return "number";
    if (stream.match(/^(true|false)/)) return "keyword";
    stream.next();
    return "punctuation";
  },
  languageData: { commentTokens: { line: "#" }, closeBrackets: { brackets: ["(", "[", "{", "\""] } },
  tokenTable: { property: tags.propertyName, function: tags.function(tags.variableName) },
});

export const colours = HighlightStyle.define([
  { tag: tags.comment, color: "var(--quiet)", fontStyle: "italic" },
  { tag: tags.heading, color: "var(--accent)", fontWeight: "bold" },
  { tag: tags.propertyName, color: "var(--ink)", fontWeight: "600" },
  { tag: tags.string, color: "var(--quiet)" },
  { tag: tags.number, color: "var(--axis-y)" },
  { tag: tags.keyword, color: "var(--clip)" },
  { tag: tags.function(tags.variableName), color: "var(--centre)" },
  { tag: tags.variableName, color: "var(--contour)" },
]);

/** Names that the document itself gives: parameters, constants, definitions, coordinates, channels. */
export function ownNames(text: string): { label: string; type: string }[] {
  const found = new Map<string, string>();
  let table = "";
  for (const line of text.split("\n")) {
    const heading = /^\s*\[+([^\]]*)\]+/.exec(line);
    if (heading) table = heading[1]!.trim();
    const key = /^\s*(?:"([^"]+)"|([\p{L}_][\p{L}\p{N}_]*))\s*=/u.exec(line);
    if (key && ["parameters", "constants", "definitions"].includes(table)) {
      const name = (key[1] ?? key[2])!;
      found.set(name.split("(")[0]!.trim(), name.includes("(") ? "function" : table === "parameters" ? "variable" : "constant");
    }
    if (/^\s*(coordinates|channels)\s*=/.test(line)) {
      for (const word of line.matchAll(/"([^"]+)"/g)) found.set(word[1]!, "property");
    }
  }
  return [...found].map(([label, type]) => ({ label, type, boost: 2 }));
}

export function complete(context: CompletionContext): CompletionResult | null {
  const word = context.matchBefore(/[\p{L}_[][\p{L}\p{N}_]*/u);
  if (!word && !context.explicit) return null;
  const line = context.state.doc.lineAt(context.pos);
  const before = line.text.slice(0, context.pos - line.from);
  const isInString = (before.match(/"/g)?.length ?? 0) % 2 === 1 || (before.match(/'/g)?.length ?? 0) % 2 === 1;
  const options = isInString || /parameters\s*=/.test(before)
    ? [...ownNames(context.state.doc.toString()), ...FUNCTIONS.map((label) => ({ label, type: "function", apply: `${label}(` })), ...WORDS.map((label) => ({ label, type: "keyword" }))]
    : KEYS.map((label) => ({ label, type: "property" }));
  return { from: word?.from ?? context.pos, options, validFor: /^[\p{L}\p{N}_]*$/u };
}
