#include <algorithm>
#include <cinttypes>
#include <cstdio>
#include <stdexcept>

#include <iotcloud/drivers/turtle/frame_log.h>

namespace iotcloud::drivers::turtle {

namespace {

constexpr double set_point = 0.7;  // m, docs/wire.md#follower
constexpr std::size_t most_latencies = 1'000'000;
constexpr std::size_t raw_bytes = depth::frame_pixels * sizeof(std::uint16_t);

const char* text(PublishStatus status) {
  switch (status) {
    case PublishStatus::accepted:
      return "accepted";
    case PublishStatus::would_block:
      return "would_block";
    case PublishStatus::closed:
      return "closed";
  }
  return "";
}

}  // namespace

void FrameLog::open_trace(const std::string& path) {
  trace_.open(path, std::ios::trunc);
  if (!trace_) {
    throw std::runtime_error("property \"trace\": cannot write \"" + path +
                             "\"; name a file in a folder that exists and may be written");
  }
  trace_ << "seq,time_ms,capture_s,device_s,robot_x,robot_y,robot_heading,person_x,person_y,distance,error,visible,"
            "in_box,render_us,encode_us,raw_bytes,payload_bytes,published,answered,latency_us,linear,angular,monotonic_"
            "us\n";
}

void FrameLog::add(const FrameRecord& record) {
  waiting_.push_back(record);
  ++totals_.frames;
  totals_.raw_bytes += raw_bytes;
  totals_.payload_bytes += record.payload_bytes;
  if (record.published != PublishStatus::accepted) ++totals_.refused;
}

void FrameLog::repeat_newest(Instant captured, PublishStatus published) {
  if (waiting_.empty()) return;
  waiting_.back().captured = captured;
  waiting_.back().published = published;
}

const FrameRecord* FrameLog::answer(std::int64_t time_ms, const Velocity& command, Instant arrived) {
  const auto found = std::lower_bound(waiting_.begin(), waiting_.end(), time_ms,
                                      [](const FrameRecord& record, std::int64_t t) { return record.time_ms < t; });
  if (found == waiting_.end() || found->time_ms != time_ms || found->answer) return nullptr;
  found->answer = command;
  found->latency = std::chrono::duration_cast<std::chrono::microseconds>(arrived - found->captured);
  ++totals_.answered;
  if (totals_.latencies_us.size() < most_latencies) {
    totals_.latencies_us.push_back(static_cast<std::uint32_t>(found->latency.count()));
  }
  return &*found;
}

void FrameLog::tidy(Instant now) {
  // Keeps the newest frame: lock step may send it again.
  while (waiting_.size() > 1 && (waiting_.front().answer || now - waiting_.front().captured > patience)) {
    write(waiting_.front());
    waiting_.pop_front();
  }
  if (trace_.is_open() && now - flushed_ >= std::chrono::seconds(1)) {
    trace_.flush();
    flushed_ = now;
  }
}

void FrameLog::close() {
  for (const FrameRecord& record : waiting_) write(record);
  waiting_.clear();
  if (trace_.is_open()) trace_.close();
}

void FrameLog::write(const FrameRecord& record) {
  if (!trace_.is_open()) return;
  char line[512];
  int length = 0;
  const auto append = [&](const char* format, auto... values) {
    const int room = static_cast<int>(sizeof line) - length;
    length += std::min(room - 1, std::snprintf(line + length, static_cast<std::size_t>(room), format, values...));
  };
  append("%" PRIu64 ",%" PRId64 ",%.6f,%.6f,", record.sequence, record.time_ms,
         std::chrono::duration<double>(record.captured - origin_).count(), record.device_time_s);
  if (const auto& truth = record.truth) {
    append("%.4f,%.4f,%.5f,%.4f,%.4f,%.4f,%.4f,%d,%d,%.1f,", truth->robot_x, truth->robot_y, truth->robot_heading,
           truth->person_x, truth->person_y, truth->distance, truth->distance - set_point, truth->visible ? 1 : 0,
           truth->in_box ? 1 : 0, truth->render_us);
  } else {
    append("%s", ",,,,,,,,,,");
  }
  append("%.1f,%zu,%zu,%s,", record.encode_us, raw_bytes, record.payload_bytes, text(record.published));
  if (record.answer) {
    append("1,%" PRId64 ",%.6f,%.6f", static_cast<std::int64_t>(record.latency.count()), record.answer->linear,
           record.answer->angular);
  } else {
    append("%s", "0,,,");
  }
  append(",%.1f\n", std::chrono::duration<double, std::micro>(record.captured.time_since_epoch()).count());
  trace_.write(line, length);
}

}  // namespace iotcloud::drivers::turtle
