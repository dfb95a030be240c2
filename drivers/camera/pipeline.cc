#include <algorithm>
#include <array>
#include <atomic>
#include <span>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include <gst/app/gstappsink.h>
#include <gst/gst.h>

#include <iotcloud/drivers/camera/pipeline.h>

namespace iotcloud::drivers::camera {

namespace {

/// GStreamer, from its first use to the end of the process.
void need_library() {
  static const bool started = [] {
    gst_segtrap_set_enabled(FALSE);  // the driver host has handlers of its own
    GError* error = nullptr;
    if (gst_init_check(nullptr, nullptr, &error) != FALSE) return true;
    const std::string why = error ? error->message : "no reason given";
    g_clear_error(&error);
    throw std::runtime_error("GStreamer cannot be started: " + why);
  }();
  static_cast<void>(started);
}

struct Unref {
  void operator()(GstElement* element) const { gst_object_unref(element); }
  void operator()(GstBus* bus) const { gst_object_unref(bus); }
  void operator()(GstPad* pad) const { gst_object_unref(pad); }
  void operator()(GstClock* clock) const { gst_object_unref(clock); }
  void operator()(GstCaps* caps) const { gst_caps_unref(caps); }
  void operator()(GstSample* sample) const { gst_sample_unref(sample); }
  void operator()(GstMessage* message) const { gst_message_unref(message); }
};
template <typename Object>
using Owned = std::unique_ptr<Object, Unref>;

/// Debian's package of an element, for people.
const char* package_of(std::string_view element) {
  constexpr std::array good{"v4l2src", "rtspsrc", "jpegenc"};
  constexpr std::array bad{"h264parse", "openh264enc"};
  if (std::find(good.begin(), good.end(), element) != good.end()) return "gstreamer1.0-plugins-good";
  if (std::find(bad.begin(), bad.end(), element) != bad.end()) return "gstreamer1.0-plugins-bad";
  return "gstreamer1.0-plugins-base";
}

std::runtime_error lacks(const char* element) {
  return std::runtime_error(std::string("GStreamer has no element ") + element + "; install Debian's package " +
                            package_of(element) + ", and start the driver host again");
}

/// What an error says; GStreamer's reason is in the last line of what it gives to developers.
std::string text_of_error(GstMessage* message) {
  GError* error = nullptr;
  gchar* debug = nullptr;
  gst_message_parse_error(message, &error, &debug);
  std::string text = error ? error->message : "an error without a text";
  const std::string more = debug ? debug : "";
  g_clear_error(&error);
  g_free(debug);
  const auto line = more.rfind('\n');
  if (line != std::string::npos && line + 1 < more.size()) text += " " + more.substr(line + 1);
  return text;
}

std::string text_of(const GstStructure& structure, const char* field) {
  const gchar* text = gst_structure_get_string(&structure, field);
  return text ? text : "";
}

/// The caps of what a pad gives, as far as they are known.
Owned<GstCaps> caps_of(GstPad* pad) {
  if (GstCaps* caps = gst_pad_get_current_caps(pad)) return Owned<GstCaps>(caps);
  return Owned<GstCaps>(gst_pad_query_caps(pad, nullptr));
}

std::string_view media_of(const GstCaps* caps) {
  if (gst_caps_is_empty(caps) || gst_caps_is_any(caps)) return "";
  return gst_structure_get_name(gst_caps_get_structure(caps, 0));
}

}  // namespace

class Pipeline::Impl {
 public:
  Impl(DriverContext& context, Options options, Handlers handlers);
  ~Impl();
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  std::optional<Frame> take();

 private:
  GstElement* add(const char* element);
  GstElement* add_filter(const std::string& caps);
  void add_source();
  void add_sink();
  // On threads of GStreamer.
  bool passes_on(const GstCaps* caps) const;
  void decoded(GstPad* pad);
  void add_tail(GstPad* pad, const GstCaps* caps);
  bool is_due(GstBuffer* buffer);
  void tell_frames();
  void finish(bool failed, std::string reason);
  // On the event thread.
  void read_bus();
  void ended(bool failed, const std::string& reason);

  DriverContext& context_;
  const Options options_;
  const Handlers handlers_;
  /// false: the object is destroyed. Used on the event thread only.
  const std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);
  Owned<GstElement> pipeline_;
  Owned<GstBus> bus_;
  GstElement *decoder_ = nullptr, *sink_ = nullptr;  ///< the pipeline's
  std::optional<HandlerId> messages_;
  std::string missing_;  ///< what GStreamer has no plugin for
  bool ended_ = false;
  std::atomic<bool> linked_{false};  ///< there is video
  std::atomic<bool> told_{false};    ///< the event thread knows of frames
  std::optional<GstClockTime> due_;  ///< of the next frame; used by the thread of the video alone
};

Pipeline::Pipeline(DriverContext& context, const Options& options, Handlers handlers) {
  need_library();
  impl_ = std::make_unique<Impl>(context, options, std::move(handlers));
}

Pipeline::~Pipeline() = default;

std::optional<Frame> Pipeline::take() {
  return impl_->take();
}

Pipeline::Impl::Impl(DriverContext& context, Options options, Handlers handlers)
    : context_(context),
      options_(std::move(options)),
      handlers_(std::move(handlers)),
      pipeline_(gst_pipeline_new(nullptr)),
      bus_(gst_pipeline_get_bus(GST_PIPELINE(pipeline_.get()))) {
  decoder_ = add("decodebin");
  add_source();
  add_sink();
  for (const char* later : {options_.h264 ? "h264parse" : "jpegenc", "videoconvert", "videoscale"}) {
    GstElementFactory* factory = gst_element_factory_find(later);
    if (!factory) throw lacks(later);
    gst_object_unref(factory);
  }
  g_signal_connect(decoder_, "autoplug-continue",
                   G_CALLBACK(+[](GstElement*, GstPad*, GstCaps* caps, gpointer impl) -> gboolean {
                     return !static_cast<Impl*>(impl)->passes_on(caps);
                   }),
                   this);
  g_signal_connect(decoder_, "pad-added",
                   G_CALLBACK(+[](GstElement*, GstPad* pad, gpointer impl) { static_cast<Impl*>(impl)->decoded(pad); }),
                   this);
  g_signal_connect(decoder_, "no-more-pads", G_CALLBACK(+[](GstElement*, gpointer impl) {
                     auto* self = static_cast<Impl*>(impl);
                     if (!self->linked_) self->finish(true, "there is no video in it");
                   }),
                   this);
  GPollFD descriptor{};
  gst_bus_get_pollfd(bus_.get(), &descriptor);
  messages_ = context_.on_readable(descriptor.fd, [this] { read_bus(); });
  if (gst_element_set_state(pipeline_.get(), GST_STATE_PLAYING) == GST_STATE_CHANGE_FAILURE) {
    read_bus();
    if (!ended_) finish(true, "GStreamer cannot start it");
  }
}

Pipeline::Impl::~Impl() {
  *alive_ = false;
  if (messages_) context_.stop(*messages_);
  gst_element_set_state(pipeline_.get(), GST_STATE_NULL);  // returns when GStreamer's threads have ended
}

GstElement* Pipeline::Impl::add(const char* element) {
  GstElement* made = gst_element_factory_make(element, nullptr);
  if (!made) throw lacks(element);
  gst_bin_add(GST_BIN(pipeline_.get()), made);
  return made;
}

GstElement* Pipeline::Impl::add_filter(const std::string& caps) {
  GstElement* filter = add("capsfilter");
  const Owned<GstCaps> wanted(gst_caps_from_string(caps.c_str()));
  g_object_set(filter, "caps", wanted.get(), nullptr);
  return filter;
}

void Pipeline::Impl::add_source() {
  GstElement* source = nullptr;
  switch (options_.kind) {
    case SourceKind::test: {
      source = add("videotestsrc");
      g_object_set(source, "is-live", TRUE, nullptr);
      gst_util_set_object_arg(G_OBJECT(source), "pattern", options_.place.c_str());
      GstElement* size = add_filter("video/x-raw,width=640,height=480,framerate=30/1");
      gst_element_link_many(source, size, decoder_, nullptr);
      return;
    }
    case SourceKind::v4l2:
      source = add("v4l2src");
      g_object_set(source, "device", options_.place.c_str(), nullptr);
      break;
    case SourceKind::file:
      source = add("filesrc");
      g_object_set(source, "location", options_.place.c_str(), nullptr);
      break;
    case SourceKind::rtsp:
      source = add("rtspsrc");
      g_object_set(source, "location", options_.place.c_str(), "latency", static_cast<guint>(options_.latency.count()),
                   nullptr);
      gst_util_set_object_arg(G_OBJECT(source), "protocols", options_.udp ? "udp" : "tcp");
      if (!options_.user.empty())
        g_object_set(source, "user-id", options_.user.c_str(), "user-pw", options_.password.c_str(), nullptr);
      g_signal_connect(source, "select-stream",
                       G_CALLBACK(+[](GstElement*, guint, GstCaps* caps, gpointer) -> gboolean {
                         return text_of(*gst_caps_get_structure(caps, 0), "media") == "video";
                       }),
                       nullptr);
      g_signal_connect(source, "pad-added", G_CALLBACK(+[](GstElement*, GstPad* pad, gpointer impl) {
                         const Owned<GstPad> in(gst_element_get_static_pad(static_cast<Impl*>(impl)->decoder_, "sink"));
                         if (!gst_pad_is_linked(in.get())) gst_pad_link(pad, in.get());
                       }),
                       this);
      return;
  }
  gst_element_link(source, decoder_);
}

void Pipeline::Impl::add_sink() {
  constexpr guint most_waiting = 4;
  sink_ = add("appsink");
  // A file is played at its own pace; what a camera sends is passed on at once.
  g_object_set(sink_, "max-buffers", most_waiting, "sync", static_cast<gboolean>(!options_.is_live()),
               "enable-last-sample", FALSE, nullptr);
  GstAppSinkCallbacks callbacks{};
  callbacks.new_sample = [](GstAppSink*, gpointer impl) {
    static_cast<Impl*>(impl)->tell_frames();
    return GST_FLOW_OK;
  };
  gst_app_sink_set_callbacks(GST_APP_SINK(sink_), &callbacks, this, nullptr);
}

/// Whether what has these caps is what is wanted already, or no video, so that nothing is to decode it.
bool Pipeline::Impl::passes_on(const GstCaps* caps) const {
  const std::string_view media = media_of(caps);
  if (media.starts_with("audio/") || media.starts_with("text/") || media.starts_with("subpicture/")) return true;
  if (options_.limits_size()) return false;
  // Single frames of H.264 cannot be left out.
  if (options_.h264) return media == "video/x-h264" && options_.rate == 0;
  // In a file, these caps may be those of bytes in which no frame begins or ends.
  return media == "image/jpeg" && options_.is_live();
}

void Pipeline::Impl::decoded(GstPad* pad) {
  const Owned<GstCaps> caps = caps_of(pad);
  const std::string_view media = media_of(caps.get());
  if (!media.starts_with("video/") && !media.starts_with("image/")) return;
  if (linked_.exchange(true)) return;  // a second picture, of a file
  try {
    add_tail(pad, caps.get());
  } catch (const std::exception& e) {
    finish(true, e.what());
  }
}

void Pipeline::Impl::add_tail(GstPad* pad, const GstCaps* caps) {
  std::vector<GstElement*> tail;
  const bool raw = media_of(caps) == "video/x-raw";
  if (raw) {
    const auto range = [](const char* side, int most) {
      return most == 0 ? std::string()
                       : "," + std::string(side) + "=(int)[2," + std::to_string(most - most % 2) + ",2]";
    };
    // JPEG of other formats, RGB say, is not what all decoders take.
    std::string wanted = "video/x-raw,format=I420";
    if (options_.limits_size()) {
      wanted += range("width", options_.width) + range("height", options_.height) + ",pixel-aspect-ratio=1/1";
    }
    tail = {add("videoconvert"), add("videoscale"), add_filter(wanted)};
  }
  if (raw && options_.h264) {
    constexpr int bits_in_kbit = 1000, frames_to_next_key = 30;
    tail.push_back(add("openh264enc"));
    g_object_set(tail.back(), "bitrate", static_cast<guint>(options_.bitrate_kbps * bits_in_kbit), "gop-size",
                 static_cast<guint>(frames_to_next_key), nullptr);
    gst_util_set_object_arg(G_OBJECT(tail.back()), "rate-control", "bitrate");
  } else if (raw) {
    tail.push_back(add("jpegenc"));
    g_object_set(tail.back(), "quality", options_.quality, nullptr);
  }
  if (options_.h264) {
    tail.push_back(add("h264parse"));
    g_object_set(tail.back(), "config-interval", -1, nullptr);  // each key frame has what a decoder needs
    tail.push_back(add_filter("video/x-h264,stream-format=byte-stream,alignment=au"));
  }
  tail.push_back(sink_);
  for (std::size_t i = 1; i < tail.size(); ++i) gst_element_link(tail[i - 1], tail[i]);
  if (options_.rate > 0) {
    gst_pad_add_probe(
        pad, GST_PAD_PROBE_TYPE_BUFFER,
        [](GstPad*, GstPadProbeInfo* info, gpointer impl) {
          return static_cast<Impl*>(impl)->is_due(GST_PAD_PROBE_INFO_BUFFER(info)) ? GST_PAD_PROBE_OK
                                                                                   : GST_PAD_PROBE_DROP;
        },
        this, nullptr);
  }
  const Owned<GstPad> in(gst_element_get_static_pad(tail.front(), "sink"));
  if (gst_pad_link(pad, in.get()) != GST_PAD_LINK_OK)
    throw std::runtime_error("its video, " + std::string(media_of(caps)) + ", cannot be used");
  for (std::size_t i = tail.size(); i-- > 0;) gst_element_sync_state_with_parent(tail[i]);
}

/// Whether a frame is to be passed on, so that there are no more than `rate` a second.
bool Pipeline::Impl::is_due(GstBuffer* buffer) {
  constexpr GstClockTime jitter_share = 10;
  const GstClockTime at = GST_BUFFER_PTS(buffer);
  const auto period = static_cast<GstClockTime>(static_cast<double>(GST_SECOND) / options_.rate);
  if (!GST_CLOCK_TIME_IS_VALID(at)) return true;
  if (due_ && at + period / jitter_share < *due_) return false;
  // After a frame that comes late the next one may come sooner, so that the mean is kept; after a gap it may not.
  due_ = due_ && at < *due_ + period ? *due_ + period : at + period;
  return true;
}

void Pipeline::Impl::tell_frames() {
  if (told_.exchange(true)) return;
  context_.post([this, alive = alive_] {
    if (!*alive) return;
    told_ = false;
    if (!ended_) handlers_.on_frames();
  });
}

void Pipeline::Impl::finish(bool failed, std::string reason) {
  context_.post([this, alive = alive_, failed, reason = std::move(reason)] {
    if (*alive) ended(failed, reason);
  });
}

void Pipeline::Impl::ended(bool failed, const std::string& reason) {
  if (std::exchange(ended_, true)) return;
  const auto on_end = handlers_.on_end;  // the call may destroy this object
  on_end(failed, reason);
}

void Pipeline::Impl::read_bus() {
  while (const Owned<GstMessage> message{gst_bus_pop(bus_.get())}) {
    switch (GST_MESSAGE_TYPE(message.get())) {
      case GST_MESSAGE_ERROR: {
        const std::string text = text_of_error(message.get());
        finish(true, missing_.empty() ? text : text + "; GStreamer has no plugin for: " + missing_);
        break;
      }
      case GST_MESSAGE_EOS:
        finish(false, "it has ended");
        break;
      case GST_MESSAGE_ELEMENT: {
        const GstStructure* told = gst_message_get_structure(message.get());
        if (told && gst_structure_has_name(told, "missing-plugin")) missing_ = text_of(*told, "name");
        break;
      }
      default:
        break;
    }
  }
}

std::optional<Frame> Pipeline::Impl::take() {
  const Owned<GstSample> sample(gst_app_sink_try_pull_sample(GST_APP_SINK(sink_), 0));
  if (!sample) return std::nullopt;
  GstBuffer* buffer = gst_sample_get_buffer(sample.get());
  Frame frame;
  if (const GstCaps* caps = gst_sample_get_caps(sample.get())) {
    const GstStructure* structure = gst_caps_get_structure(caps, 0);
    gst_structure_get_int(structure, "width", &frame.width);
    gst_structure_get_int(structure, "height", &frame.height);
  }
  frame.key = !GST_BUFFER_FLAG_IS_SET(buffer, GST_BUFFER_FLAG_DELTA_UNIT);
  const GstSegment* segment = gst_sample_get_segment(sample.get());
  const GstClockTime at = GST_BUFFER_PTS(buffer);
  if (segment && segment->format == GST_FORMAT_TIME && GST_CLOCK_TIME_IS_VALID(at)) {
    const auto position = gst_segment_to_stream_time(segment, GST_FORMAT_TIME, at);
    if (GST_CLOCK_TIME_IS_VALID(position)) frame.position_ms = static_cast<std::int64_t>(position / GST_MSECOND);
    const auto running = gst_segment_to_running_time(segment, GST_FORMAT_TIME, at);
    const Owned<GstClock> clock(gst_element_get_clock(pipeline_.get()));
    if (options_.is_live() && clock && GST_CLOCK_TIME_IS_VALID(running)) {
      const auto captured = gst_element_get_base_time(pipeline_.get()) + running;
      const auto present = gst_clock_get_time(clock.get());
      const auto age = present > captured ? present - captured : 0;
      frame.time_ms = g_get_real_time() / 1000 - static_cast<std::int64_t>(age / GST_MSECOND);
    }
  }
  // The bytes are copied, because a camera has few buffers and waits for them.
  GstMapInfo map{};
  if (gst_buffer_map(buffer, &map, GST_MAP_READ) != FALSE) {
    frame.payload = Payload::copy(std::as_bytes(std::span(map.data, map.size)));
    gst_buffer_unmap(buffer, &map);
  }
  return frame;
}

}  // namespace iotcloud::drivers::camera
