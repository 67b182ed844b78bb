// A WebSocket of the service that is opened again whenever it closes, sooner at first. Credit is given back after each message
// has been used, so that what is slow gets fewer messages, and the newest.

export interface Stream {
  close(): void;
}

const FIRST_WAIT_MS = 300;
const LAST_WAIT_MS = 3000;

export interface Listener {
  /** Its result gives the credit back. */
  message(data: string | ArrayBuffer): void | Promise<void>;
  /** Called with false when it closes, and with what was said. */
  open?(isOpen: boolean, reason: string): void;
}

export function stream(path: () => string, protocols: string[], listener: Listener): Stream {
  let socket: WebSocket | null = null;
  let timer = 0;
  let wait = FIRST_WAIT_MS;
  let isWanted = true;

  function connect() {
    const opened = new WebSocket(`${location.origin.replace(/^http/, "ws")}${path()}`, protocols);
    socket = opened;
    let owed = 0;
    opened.binaryType = "arraybuffer";
    opened.onopen = () => listener.open?.(true, "");
    opened.onmessage = async (event) => {
      if (socket !== opened) return;
      wait = FIRST_WAIT_MS;
      try {
        await listener.message(event.data);
      } finally {
        // One that cannot be shown must not be the last. Those that are done together are told together.
        if (owed++ === 0) queueMicrotask(() => { give(opened, owed); owed = 0; });
      }
    };
    opened.onclose = (event) => {
      if (socket !== opened) return;
      socket = null;
      if (!isWanted) return;
      listener.open?.(false, event.reason);
      timer = self.setTimeout(connect, wait);
      wait = Math.min(LAST_WAIT_MS, wait * 1.7);
    };
  }

  connect();
  return {
    close() {
      isWanted = false;
      clearTimeout(timer);
      const last = socket;
      socket = null;
      // Closing one that is not open yet would be told as a failure.
      if (last?.readyState === WebSocket.CONNECTING) last.onopen = () => last.close();
      else last?.close();
    },
  };
}

function give(socket: WebSocket, credit: number) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ credit }));
}
