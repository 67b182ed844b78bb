// Which model a session fits: asked for, and active since.
import { signal } from "@preact/signals";
import { said, segment, send } from "./api";
import { refresh } from "./store";

interface SwapAnswer {
  requested_model: string;
  active_model: string;
  active_since_frame: number;
  carried: string[];
  reset: string[];
  compile_ms: number;
}

export interface SwapNews { requested: string; isWaiting: boolean; answer: SwapAnswer | null; fault: string }

/** The last swap that this page asked for. */
export const swapNews = signal<SwapNews | null>(null);

export async function swap(session: string, model: string): Promise<boolean> {
  swapNews.value = { requested: model, isWaiting: true, answer: null, fault: "" };
  try {
    const answer = await send<SwapAnswer>("PUT", `/v1/sessions/${segment(session)}/model`, { model });
    swapNews.value = { requested: model, isWaiting: false, answer, fault: "" };
    await refresh();
    return true;
  } catch (error) {
    swapNews.value = { requested: model, isWaiting: false, answer: null, fault: said(error) };
    return false;
  }
}
