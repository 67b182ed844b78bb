// The camera's picture with its frame in the look of the session's state, and what to do about that.
import { GREY } from "../draw/colour";
import { link } from "../state/preview";
import { framePicture, frameRatio, hasSaturated, lacking, shownHead, stepsBack } from "../state/pictures";
import { standing, standingClass } from "../state/standing";
import { beat, centreOf, document_, paused } from "../state/store";
import { PictureView } from "./PictureView";

export function Screen() {
  const now = standing.value;
  void beat.value; // the scale of the ellipse, a few times a second
  const scale = framePicture.value?.ellipseScale ?? 1;
  return (
    <div class="stage">
      <div class={`screen ${standingClass(now.word)}`}>
        <PictureView label="camera" palette={GREY} centre={() => centreOf(document_.peek())} picture={framePicture}
          ratio={frameRatio.value} stretches />
        {lacking.value && <p class="over">{lacking.value}</p>}
        {now.hint && !lacking.value && <p class="over low">{now.hint}</p>}
        {paused.value && <p class="over top">paused · frame {shownHead.value?.frame}{stepsBack.value > 0 ? ` · ${stepsBack.value} back` : ""} · space goes on, arrows step</p>}
      </div>
      <p class="key">
        <span><i class="line" /> fitted contour</span>
        <span><i class="cross" /> centre{scale > 1 ? `, 1σ ellipse × ${scale}` : ", 1σ ellipse"}</span>
        <span><i class="dashed" /> window</span>
        {hasSaturated.value ? <span><i class="block saturated" /> saturated</span> : null}
        <span class="quiet">{link.value}</span>
      </p>
    </div>
  );
}
