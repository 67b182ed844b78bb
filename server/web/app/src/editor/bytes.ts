// The service counts bytes of UTF-8, editors count UTF-16: the way from one to the other.

export interface Places { toByte(position: number): number; fromByte(byte: number): number }

export function places(text: string): Places {
  let isAscii = true;
  for (let i = 0; i < text.length && isAscii; i++) isAscii = text.charCodeAt(i) < 128;
  if (isAscii) return { toByte: (position) => position, fromByte: (byte) => Math.min(byte, text.length) };
  const starts = new Uint32Array(text.length + 1); // the byte at which each position starts
  let byte = 0;
  for (let i = 0; i < text.length; i++) {
    starts[i] = byte;
    const code = text.charCodeAt(i);
    const isHighHalf = code >= 0xd800 && code < 0xdc00;
    byte += code < 0x80 ? 1 : code < 0x800 ? 2 : isHighHalf ? 4 : code >= 0xdc00 && code < 0xe000 ? 0 : 3;
  }
  starts[text.length] = byte;
  return {
    toByte: (position) => starts[Math.max(0, Math.min(position, text.length))]!,
    fromByte(wanted) {
      let [low, high] = [0, text.length];
      while (low < high) {
        const middle = (low + high + 1) >> 1;
        if (starts[middle]! <= wanted) low = middle;
        else high = middle - 1;
      }
      return low;
    },
  };
}
