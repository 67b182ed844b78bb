// Which model a session fits: asked for, and active since.
import { signal } from "@preact/signals";
import { newestOnly, said, segment, send } from "./api";
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

const swapping = newestOnly();

export async function swap(session: string, model: string): Promise<boolean> {
  const isNewest = swapping();
  swapNews.value = { requested: model, isWaiting: true, answer: null, fault: "" };
  try {
    const answer = await send<SwapAnswer>("PUT", `/v1/sessions/${segment(session)}/model`, { model });
    if (isNewest()) swapNews.value = { requested: model, isWaiting: false, answer, fault: "" };
    await refresh();
    return true;
  } catch (error) {
    if (isNewest()) swapNews.value = { requested: model, isWaiting: false, answer: null, fault: said(error) };
    return false;
  }
}
