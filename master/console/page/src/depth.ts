// Depth frames of the turtle driver: drivers/depth/README.md has the formats. This decoder gives the same millimetres as the
// one of C++, checks as much, and refuses the same frames; tests compare both.

export const width = 640, height = 480;
const pixels = width * height;

/** Why a payload is no depth frame. */
export class NoDepth extends Error {}

// ---- tables

/** Trunc(1000 * 0.1236 * tan(d / 2842.5 + 1.1863)), and 0 = no reading. */
const mmOfDisparity = Uint16Array.from({length: 2048}, (_, d) => (d < 1023 ? 1000 * 0.1236 * Math.tan(d / 2842.5 + 1.1863) : 0));
const mmOfCode = Uint16Array.from({length: 256}, (_, code) => (code ? 90300 / (code + 21.575) : 0));

const crcOfByte = Uint32Array.from({length: 256}, (_, byte) => {
  let sum = byte;
  for (let bit = 0; bit < 8; bit++) sum = sum & 1 ? (sum >>> 1) ^ 0xedb88320 : sum >>> 1;
  return sum;
});
function crc32(sum: number, bytes: Uint8Array): number {
  sum = ~sum;
  for (let i = 0; i < bytes.length; i++) sum = (sum >>> 8) ^ crcOfByte[(sum ^ bytes[i]!) & 0xff]!;
  return ~sum >>> 0;
}

// ---- the reference codec: a raw block of Snappy

const outside = "a Snappy block that is cut off or damaged";

/** The number at the beginning, and where it ends. */
function varint(bytes: Uint8Array): [number, number] {
  let number = 0;
  for (let i = 0; i < 5 && i < bytes.length; i++) {
    number += (bytes[i]! & 0x7f) * 2 ** (7 * i);
    if (!(bytes[i]! & 0x80)) return [number, i + 1];
  }
  throw new NoDepth("neither a tagged depth frame nor a raw Snappy block");
}

function unsnappy(from: Uint8Array, to: Uint8Array): void {
  const [length, begin] = varint(from);
  if (length !== to.length) throw new NoDepth(`a Snappy block of ${length} bytes; a depth frame has ${to.length}`);
  let at = begin, out = 0;
  while (at < from.length) {
    const tag = from[at++]!, kind = tag & 3;
    let size = (tag >> 2) + 1, back = 0;
    if (kind === 0) {
      if (size > 60) {
        const more = size - 60;
        if (at + more > from.length) throw new NoDepth(outside);
        size = 1;
        for (let i = 0; i < more; i++) size += from[at + i]! * 2 ** (8 * i);
        at += more;
      }
      if (at + size > from.length || out + size > to.length) throw new NoDepth(outside);
      to.set(from.subarray(at, at + size), out);
      at += size;
      out += size;
      continue;
    }
    const more = kind === 1 ? 1 : kind === 2 ? 2 : 4;
    if (at + more > from.length) throw new NoDepth(outside);
    for (let i = 0; i < more; i++) back += from[at + i]! * 2 ** (8 * i);
    at += more;
    if (kind === 1) {
      back += (tag >> 5) << 8;
      size = ((tag >> 2) & 7) + 4;
    }
    if (!back || back > out || out + size > to.length) throw new NoDepth(outside);
    if (back >= size) to.copyWithin(out, out - back, out - back + size);
    else for (let i = 0; i < size; i++) to[out + i] = to[out + i - back]!;
    out += size;
  }
  if (out !== to.length) throw new NoDepth(outside);
}

// ---- the other codecs: symbols of groups of pixels, in four lanes (drivers/depth/groups.h, entropy.h)

const malformed = "a depth frame with a right checksum that no encoder wrote";
const scaleBits = 10, scale = 1 << scaleBits, lowest = 1 << 16;
const groupSymbols = 83, noneSymbol = 81, otherSymbol = 82, pixelSymbols = 32;
const pixelNone = 0, pixelLiteral = 1, pixelZero = 17;
const isRead = 0, isNone = 1, isOther = 2;
const leftClasses = 4, contexts = 84 * leftClasses, firstPixelTable = contexts + 1, tables = firstPixelTable + 8;
const lanes = 4, rowSteps = {4: 160 * 9, 2: 320 * 5};

interface Plane {
  pixels: 4 | 2;   // of a group
  reach: 1 | 4;    // of a symbol's rises
  none: number;
  beginning: number;
  bits: number;    // of a value
  mask: number;    // of a value's memory
}
const codePlane: Plane = {pixels: 4, reach: 1, none: 0, beginning: 100, bits: 8, mask: 0xff};
const disparityPlane: Plane = {pixels: 2, reach: 4, none: 2047, beginning: 700, bits: 11, mask: 0xffff};

/** Of each symbol: how much each pixel of a group rises, and the left context that its last pixel gives. */
function risesOf({pixels: size, reach}: Plane): {rises: Int8Array; left: Uint8Array} {
  const values = 2 * reach + 1, rises = new Int8Array(noneSymbol * size), left = new Uint8Array(84).fill(1);
  for (let symbol = 0; symbol < noneSymbol; symbol++) {
    let rest = symbol, last = 0;
    for (let i = 0; i < size; i++) {
      last = (rest % values) - reach;
      rises[symbol * size + i] = last;
      rest = Math.trunc(rest / values);
    }
    left[symbol] = last < 0 ? 0 : last > 0 ? 2 : 1;
  }
  left[noneSymbol] = left[otherSymbol] = 3;
  return {rises, left};
}

class Bits {
  at = 0;
  constructor(private readonly bytes: Uint8Array) {}
  get(count: number): number {
    let value = 0;
    for (let i = 0; i < count; i++, this.at++) value |= (((this.bytes[this.at >> 3] ?? 0) >> (this.at & 7)) & 1) << i;
    return value;
  }
  gamma(): number {
    let more = 0;
    while (!this.get(1)) if (++more > scaleBits) throw new NoDepth(malformed);
    return (1 << more) | this.get(more);
  }
  get bytesRead(): number { return (this.at + 7) >> 3; }
  get overrun(): boolean { return this.at > this.bytes.length * 8; }
}

/** For each remainder of a state: the symbol (7 bits from bit 21), the distance from its first remainder (10 from 11), its share
 * (11 from 0). */
function readTable(bits: Bits, symbols: number): Uint32Array {
  const table = new Uint32Array(scale);
  let slot = 0;
  for (let symbol = 0; symbol < symbols;) {
    symbol += bits.gamma() - 1;
    if (symbol > symbols) throw new NoDepth(malformed);
    if (symbol === symbols) break;
    const share = bits.gamma();
    if (share > scale - slot) throw new NoDepth(malformed);
    for (let i = 0; i < share; i++) table[slot++] = (symbol << 21) | (i << 11) | share;
    symbol++;
  }
  if (slot !== scale || bits.overrun) throw new NoDepth(malformed);
  return table;
}

function decodePlane(bytes: Uint8Array, plane: Plane, out: Uint8Array | Uint16Array): void {
  const {pixels: size, none, mask} = plane;
  const {rises, left: leftOf} = risesOf(plane);
  const bits = new Bits(bytes);
  const own = Array.from({length: tables}, () => bits.get(1) === 1);
  const nothing = new Uint32Array(scale);
  for (let i = 0; i < scale; i++) nothing[i] = (noneSymbol << 21) | (i << 11) | scale;
  const read = own.map((is, table) => (is ? readTable(bits, table < firstPixelTable ? groupSymbols : pixelSymbols) : null));
  const tableOf = read.map((table, number) => table ?? (number < contexts ? read[contexts] : null) ?? nothing);
  if (bits.overrun) throw new NoDepth(malformed);

  let at = bits.bytesRead;
  if (bytes.length - at < lanes * 4 || bytes.length - at > rowSteps[size] * height * 2 + lanes * 4) throw new NoDepth(malformed);
  const states = new Float64Array(lanes);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length);
  for (let lane = 0; lane < lanes; lane++, at += 4) states[lane] = view.getUint32(at, true);
  if (states.some((state) => state < lowest)) throw new NoDepth(malformed);

  // What a symbol is read from is a state below 2^32, which whole numbers of 32 bits with a sign do not hold.
  let state = 0;
  const refill = (): void => {
    if (state >= lowest) return;
    state = state * 0x10000 + (at < bytes.length ? bytes[at]! | ((bytes[at + 1] ?? 0) << 8) : 0);
    at += 2;
  };
  const symbolOf = (table: Uint32Array): number => {
    const entry = table[state % scale]!;
    state = (entry & 0x7ff) * Math.floor(state / scale) + ((entry >>> 11) & 0x3ff);
    refill();
    return (entry >>> 21) & 0x7f;
  };

  const rowGroups = width / size, laneGroups = rowGroups / lanes;
  let above = new Int32Array(width).fill(plane.beginning), filled = new Int32Array(width);
  const kinds = new Uint8Array(rowGroups + 1).fill(isNone), classes = new Uint8Array(rowGroups), lefts = new Uint8Array(lanes);
  const classify = (): void => {
    for (let group = 0; group < rowGroups; group++) {
      if (kinds[group] !== isRead) {
        classes[group] = kinds[group] === isOther ? 83 : kinds[group + 1] === isNone ? 81 : 82;
        continue;
      }
      let value = 0;
      for (let i = 0, weight = 1; i < size; i++) {
        const pixel = group * size + i;
        const before = pixel ? above[pixel - 1]! : above[0]!;
        if (size === 4) {
          const step = (above[pixel]! - before) & 0xff;
          value += weight * (step === 0 ? 0 : step < 0x80 ? 1 : 2);
          weight *= 3;
        } else {
          const step = ((above[pixel]! - before) << 16) >> 16;
          value += weight * ((step < -1 ? -1 : step > 1 ? 1 : step) + 1);
          weight *= 9;
        }
      }
      classes[group] = value;
    }
  };
  for (let v = 0; v < height; v++) {
    const row = v * width, rowAbove = row - width;
    classify();
    lefts.fill(3);
    for (let step = 0; step < laneGroups; step++) {
      for (let lane = 0; lane < lanes; lane++) {
        const group = lane * laneGroups + step, first = group * size;
        state = states[lane]!;
        const symbol = symbolOf(tableOf[classes[group]! * leftClasses + lefts[lane]!]!);
        lefts[lane] = leftOf[symbol]!;
        if (symbol < noneSymbol) {
          for (let i = 0; i < size; i++) out[row + first + i] = filled[first + i] = (above[first + i]! + rises[symbol * size + i]!) & mask;
          kinds[group] = isRead;
        } else if (symbol === noneSymbol) {
          for (let i = 0; i < size; i++) {
            out[row + first + i] = none;
            filled[first + i] = above[first + i]!;
          }
          kinds[group] = isNone;
        } else {
          for (let i = first; i < first + size; i++) {
            const begins = step === 0 && i === first;
            const aboveValue = (x: number): number => (v && x < width ? out[rowAbove + x]! : none);
            const leftRead = (begins ? aboveValue(i) : out[row + i - 1]!) !== none;
            const beside = begins ? above[i]! : filled[i - 1]!;
            const table = firstPixelTable + (aboveValue(i + 1) !== none ? 4 : 0) + (aboveValue(i) !== none ? 2 : 0) + (leftRead ? 1 : 0);
            const pixel = symbolOf(tableOf[table]!);
            if (pixel === pixelNone) {
              out[row + i] = none;
              filled[i] = above[i]!;
              continue;
            }
            let value = beside + pixel - pixelZero;
            if (pixel === pixelLiteral) {
              value = state % (1 << plane.bits);
              state = Math.floor(state / (1 << plane.bits));
              refill();
            }
            out[row + i] = filled[i] = value & mask;
          }
          kinds[group] = isOther;
        }
        states[lane] = state;
      }
    }
    if (at > bytes.length) throw new NoDepth(malformed);
    [above, filled] = [filled, above];
  }
  if (at !== bytes.length || states.some((one) => one !== lowest)) throw new NoDepth(malformed);
}

// ---- a payload of any codec

/** Whether the payload begins as a depth frame does. */
export const looksLikeDepth = (payload: Uint8Array): boolean =>
  (payload[0] === 0x49 && payload[1] === 0x44 && payload[2] === 0x43) ||
  (payload[0] === 0x80 && payload[1] === 0xe0 && payload[2] === 0x12);  // Snappy's way to write 307 200

/** Millimetres, row by row from the top left; 0: no reading. \throws NoDepth */
export function millimetres(payload: Uint8Array): Uint16Array<ArrayBuffer> {
  const mm = new Uint16Array(pixels);
  if (!(payload[0] === 0x49 && payload[1] === 0x44 && payload[2] === 0x43)) {
    const codes = new Uint8Array(pixels);
    unsnappy(payload, codes);
    for (let i = 0; i < pixels; i++) mm[i] = mmOfCode[codes[i]!]!;
    return mm;
  }
  const damaged = "a depth frame that is cut off or damaged: its checksum is wrong";
  if (payload.length < 8) throw new NoDepth(damaged);
  const sum = new DataView(payload.buffer, payload.byteOffset).getUint32(4, true);
  if (crc32(crc32(0, payload.subarray(3, 4)), payload.subarray(8)) !== sum) throw new NoDepth(damaged);
  const body = payload.subarray(8);
  if (payload[3] === 1) {
    const codes = new Uint8Array(pixels);
    decodePlane(body, codePlane, codes);
    for (let i = 0; i < pixels; i++) mm[i] = mmOfCode[codes[i]!]!;
  } else if (payload[3] === 2) {
    const disparities = new Uint16Array(pixels);
    decodePlane(body, disparityPlane, disparities);
    for (let i = 0; i < pixels; i++) mm[i] = mmOfDisparity[disparities[i]! & 2047]!;
  } else {
    throw new NoDepth("a depth frame of a codec that this page does not know; it knows reference, compact and lossless");
  }
  return mm;
}

// ---- as a picture

/** Near is bright and warm, far is dark and blue, no reading is black: 4 bytes a pixel for each millimetre to 4.1 m. */
const colours = (() => {
  const stops: [number, number, number, number][] = [[300, 253, 231, 37], [900, 94, 201, 98], [1600, 33, 145, 140], [2600, 59, 82, 139], [4100, 68, 1, 84]];
  const all = new Uint32Array(4101).fill(0xff000000);
  for (let mm = 1; mm < all.length; mm++) {
    const next = Math.max(1, stops.findIndex(([at]) => at >= mm));
    const [from, to] = [stops[next - 1]!, stops[next]!];
    const part = Math.min(1, Math.max(0, (mm - from[0]) / (to[0] - from[0])));
    const [red, green, blue] = [1, 2, 3].map((i) => Math.round(from[i]! + (to[i]! - from[i]!) * part)) as [number, number, number];
    all[mm] = 0xff000000 | (blue << 16) | (green << 8) | red;
  }
  return all;
})();

export function draw(mm: Uint16Array, canvas: HTMLCanvasElement): void {
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d")!;
  const image = context.createImageData(width, height);
  const to = new Uint32Array(image.data.buffer);
  for (let i = 0; i < pixels; i++) to[i] = colours[Math.min(mm[i]!, 4100)]!;
  context.putImageData(image, 0, 0);
}
