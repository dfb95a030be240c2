#include <utility>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/client/watches.h>

namespace iotcloud::discovery {
namespace {

const config::Logger log{"discovery"};
constexpr std::chrono::milliseconds read_pause{2};
/// A long list of children is sent whole at each change: 10 000 names, some 360 KB, are read every 50 ms at most.
constexpr std::chrono::microseconds read_pause_per_name{5};
constexpr std::chrono::milliseconds retry_pause{50};
constexpr std::chrono::milliseconds denied_pause{2000};

bool same(const Reply& a, const Reply& b) {
  return a.status == b.status && a.node.version == b.node.version && a.node.created == b.node.created &&
         a.names == b.names;
}

}  // namespace

void Watch::shut() {
  if (on_node) on_node->shut();
  if (on_children) on_children->shut();
}

void Watches::add(WatchPtr watch) {
  watches_.emplace(watch->path, watch);
  touch(watch);
}

void Watches::remove(const WatchPtr& watch) {
  watch->removed = true;
  const auto [begin, end] = watches_.equal_range(watch->path);
  for (auto place = begin; place != end; ++place) {
    if (place->second == watch) {
      watches_.erase(place);
      return;
    }
  }
}

void Watches::connected() {
  connected_ = true;
  for (const auto& [path, watch] : watches_) touch(watch);
}

void Watches::changed(const std::string& path) {
  const auto [begin, end] = watches_.equal_range(path);
  for (auto place = begin; place != end; ++place) touch(place->second);
}

void Watches::touch(const WatchPtr& watch) {
  if (!connected_ || watch->scheduled) return;
  if (watch->reading) {
    watch->again = true;
    return;
  }
  SerialThread::Instant due = SerialThread::Instant::min();
  if (watch->reported) {
    due = watch->last_read + read_pause + read_pause_per_name * static_cast<int>(watch->reported->names.size());
  }
  if (due <= std::chrono::steady_clock::now()) {
    read(watch);
  } else {
    schedule(watch, due);
  }
}

void Watches::schedule(const WatchPtr& watch, SerialThread::Instant when) {
  watch->scheduled = true;
  worker_.post_at(when, [this, watch] {
    watch->scheduled = false;
    if (watch->removed || !connected_) return;
    if (watch->reading) {
      watch->again = true;
    } else {
      read(watch);
    }
  });
}

void Watches::read(const WatchPtr& watch) {
  watch->reading = true;
  watch->last_read = std::chrono::steady_clock::now();
  Done done = [this, watch](Reply reply) {
    worker_.post([this, watch, reply = std::move(reply)]() mutable { answered(watch, std::move(reply)); });
  };
  if (watch->on_node) {
    connection_.get(watch->path, true, std::move(done));
  } else {
    connection_.children(watch->path, true, std::move(done));
  }
}

void Watches::answered(const WatchPtr& watch, Reply reply) {
  watch->reading = false;
  if (watch->removed) return;
  const bool again = std::exchange(watch->again, false);
  if (reply.status != Status::ok && reply.status != Status::no_node) {
    // The next `connected` reads again; should the connection stand all the same, this does.
    const bool denied = reply.status == Status::denied;
    if (denied && !std::exchange(watch->complained, true)) {
      log.warn(
          "{} cannot be watched: it belongs to another user of the registry; are registry.user and "
          "registry.password_file those of the process that created it?",
          watch->path);
    }
    if (!watch->scheduled) {
      schedule(watch, std::chrono::steady_clock::now() + (denied ? denied_pause : retry_pause));
    }
    return;
  }
  report(*watch, std::move(reply));
  if (again) touch(watch);
}

void Watches::report(Watch& watch, Reply reply) {
  if (watch.reported && same(*watch.reported, reply)) return;
  if (watch.on_node) {
    std::optional<Node> node;
    if (reply.status == Status::ok) node = reply.node;
    watch.on_node->deliver_latest(dispatcher_, std::move(node));
    reply.node.data.clear();  // versions suffice to see a change
  } else {
    std::optional<std::vector<std::string>> names;
    if (reply.status == Status::ok) names = reply.names;
    watch.on_children->deliver_latest(dispatcher_, std::move(names));
  }
  watch.reported = std::move(reply);
}

}  // namespace iotcloud::discovery
