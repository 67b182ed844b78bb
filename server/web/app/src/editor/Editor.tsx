// The editor. It lives in a shadow root: there its styles are sheets of its own, which the page's policy allows, rather than
// elements, which it forbids.
import { autocompletion, closeBrackets, completionKeymap } from "@codemirror/autocomplete";
import { defaultKeymap, history, historyKeymap, indentWithTab } from "@codemirror/commands";
import { bracketMatching, syntaxHighlighting } from "@codemirror/language";
import { lintKeymap, linter, type Diagnostic as Mark } from "@codemirror/lint";
import { EditorState, StateEffect, StateField } from "@codemirror/state";
import { Decoration, EditorView, drawSelection, highlightActiveLine, keymap, lineNumbers, type DecorationSet } from "@codemirror/view";
import { useEffect, useRef } from "preact/hooks";
import { pointed } from "../parts/Formulas";
import { places } from "./bytes";
import { check, draft } from "./draft";
import { colours, complete, language } from "./language";

const point = StateEffect.define<{ from: number; to: number } | null>();
const pointMark = Decoration.mark({ class: "pointed" });
const pointField = StateField.define<DecorationSet>({
  create: () => Decoration.none,
  update(marks, transaction) {
    let now = marks.map(transaction.changes);
    for (const effect of transaction.effects) {
      if (effect.is(point)) now = effect.value && effect.value.to > effect.value.from ? Decoration.set(pointMark.range(effect.value.from, effect.value.to)) : Decoration.none;
    }
    return now;
  },
  provide: (field) => EditorView.decorations.from(field),
});

const look = EditorView.theme({
  "&": { height: "100%", fontSize: "13.5px", color: "var(--ink)", backgroundColor: "var(--card)" },
  "&.cm-focused": { outline: "2px solid var(--accent)", outlineOffset: "-2px" },
  ".cm-scroller": { fontFamily: "var(--mono)", lineHeight: "1.5" },
  ".cm-gutters": { backgroundColor: "transparent", color: "var(--quiet)", border: "none" },
  ".cm-activeLine, .cm-activeLineGutter": { backgroundColor: "color-mix(in srgb, var(--accent) 8%, transparent)" },
  ".cm-cursor": { borderLeftColor: "var(--ink)" },
  "&.cm-focused .cm-selectionBackground, .cm-selectionBackground": { backgroundColor: "color-mix(in srgb, var(--accent) 30%, transparent) !important" },
  ".cm-tooltip": { backgroundColor: "var(--card)", border: "1px solid var(--rule)", borderRadius: "6px", color: "var(--ink)", maxWidth: "34rem" },
  ".cm-tooltip-autocomplete ul li[aria-selected]": { backgroundColor: "var(--accent)", color: "var(--on-accent)" },
  ".cm-diagnostic": { fontFamily: "system-ui, sans-serif", padding: ".3rem .6rem", whiteSpace: "pre-wrap" },
  ".cm-matchingBracket": { backgroundColor: "var(--marked) !important" },
  ".pointed": { backgroundColor: "var(--marked)", borderRadius: "3px" },
});

/** Documents often begin with a page of comments: the first line of the model is shown first. */
function toStart(view: EditorView) {
  const first = /^(?!#|\s*$)/m.exec(view.state.doc.toString());
  // The editor alone is scrolled, not the page around it.
  view.requestMeasure({
    read: () => view.lineBlockAt(first?.index ?? 0).top,
    write: (top) => { view.scrollDOM.scrollTop = top; },
  });
}

/**
 * Browsers keep the look of lines that they join in style attributes, which the page's policy refuses. So what is typed over a selection,
 * or deletes one, changes the document here, and not first the elements on the page.
 */
function replaceSelected(event: InputEvent, view: EditorView): boolean {
  const { from, to, empty } = view.state.selection.main;
  const isDeletion = event.inputType.startsWith("delete");
  if (empty || !event.cancelable || !(isDeletion || event.inputType === "insertText")) return false;
  event.preventDefault();
  const text = isDeletion ? "" : event.data ?? "";
  const replace = () => view.state.update(view.state.replaceSelection(text), { userEvent: isDeletion ? "delete" : "input.type", scrollIntoView: true });
  const isHandled = !isDeletion && view.state.facet(EditorView.inputHandler).some((handle) => handle(view, from, to, text, replace));
  if (!isHandled) view.dispatch(replace());
  return true;
}

/** The same of what an input method composes. */
function deleteSelected(_: CompositionEvent, view: EditorView): boolean {
  if (!view.state.selection.main.empty) view.dispatch(view.state.replaceSelection(""));
  return false;
}

interface Props { apply: () => void }

export function Editor({ apply }: Props) {
  const holder = useRef<HTMLDivElement>(null);
  const act = useRef(apply);
  act.current = apply;

  useEffect(() => {
    const root = holder.current!.shadowRoot ?? holder.current!.attachShadow({ mode: "open" });
    const frame = document.createElement("div");
    frame.style.height = "100%";
    root.replaceChildren(frame);
    const marks = async (view: EditorView): Promise<Mark[]> => {
      const text = view.state.doc.toString();
      const found = await check(text);
      if (!found || view.state.doc.toString() !== text) return [];
      const { fromByte } = places(text);
      return found.map((fault) => {
        const [start, end] = fault.span ?? [0, 0];
        const from = fromByte(start);
        return {
          from, to: Math.max(from, fromByte(end)), severity: fault.severity === "warning" ? "warning" : "error",
          message: fault.help ? `${fault.message}\n${fault.help}` : fault.message,
        };
      });
    };
    const extensions = [
      keymap.of([{ key: "Mod-Enter", run: () => { act.current(); return true; } }]),
      lineNumbers(), history(), drawSelection(), highlightActiveLine(), bracketMatching(), closeBrackets(), language,
      syntaxHighlighting(colours), autocompletion({ override: [complete] }), linter(marks, { delay: 300 }), pointField, look,
      EditorView.lineWrapping, EditorView.contentAttributes.of({ "aria-label": "model document", spellcheck: "false" }),
      keymap.of([...completionKeymap, ...lintKeymap, ...historyKeymap, ...defaultKeymap, indentWithTab]),
      EditorView.updateListener.of((update) => { if (update.docChanged) draft.text.value = update.state.doc.toString(); }),
      EditorView.domEventHandlers({
        beforeinput: replaceSelected,
        compositionstart: deleteSelected,
        mousemove(event, over) {
          const at = over.posAtCoords({ x: event.clientX, y: event.clientY });
          if (at === null) return;
          const byte = places(over.state.doc.toString()).toByte(at);
          if (pointed.peek()?.span?.[0] !== byte) pointed.value = { span: [byte, byte + 1], value: null };
        },
        mouseleave() { pointed.value = null; },
      }),
    ];
    // A history of its own: undoing brings no other document back.
    const stateOf = (doc: string) => EditorState.create({ doc, extensions });
    const view = new EditorView({ root, parent: frame, state: stateOf(draft.text.peek()) });
    // What another part of the page puts in: a document that was chosen.
    const follow = draft.text.subscribe((text) => {
      if (text === view.state.doc.toString()) return;
      view.setState(stateOf(text));
      toStart(view);
    });
    toStart(view);
    const unpoint = pointed.subscribe((now) => {
      const { fromByte } = places(view.state.doc.toString());
      const span = now?.span;
      const range = span && span[1] - span[0] > 1 ? { from: fromByte(span[0]), to: fromByte(span[1]) } : null;
      view.dispatch({ effects: point.of(range) });
    });
    return () => { follow(); unpoint(); view.destroy(); };
  }, []);

  return <div ref={holder} class="editor" />;
}
