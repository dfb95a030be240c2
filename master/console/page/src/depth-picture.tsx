// A depth frame as a picture.
import {useEffect, useRef, useState} from "preact/hooks";
import {draw, height, millimetres, NoDepth, width} from "./depth";

export {looksLikeDepth} from "./depth";

export function Depth({payload}: {payload: Uint8Array}) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [words, setWords] = useState("");
  const [problem, setProblem] = useState("");
  useEffect(() => {
    try {
      const mm = millimetres(payload);
      draw(mm, canvas.current!);
      const read = mm.filter((value) => value > 0);
      const nearest = read.reduce((least, value) => Math.min(least, value), 65_535);
      setWords(read.length ? `nearest ${(nearest / 1000).toFixed(2)} m, ${Math.round((100 * read.length) / mm.length)} % of the pixels have a reading`
                           : "no pixel has a reading");
      setProblem("");
    } catch (error) {
      if (!(error instanceof NoDepth)) throw error;
      setProblem(error.message);
    }
  }, [payload]);
  return (
    <>
      {problem && <p class="problem">{problem}</p>}
      <figure class="depth" hidden={!!problem}>
        <canvas ref={canvas} width={width} height={height} role="img" aria-label={`Depth frame: ${words}`} />
        <figcaption><span class="scale" aria-hidden="true" /> 0.3 m to 4 m · {words}</figcaption>
      </figure>
    </>
  );
}
