#include <functional>
#include <utility>

#include <iotcloud/discovery/client/watches.h>
#include <iotcloud/discovery/logger.h>

namespace iotcloud::discovery {
namespace {

constexpr std::chrono::milliseconds read_pause{2};
/// The pause between two reads of a list of children grows with the list, because the server always sends all of it: a
/// list of 10 000 names, some 360 KB, is read every 50 ms at most.
constexpr std::chrono::microseconds read_pause_per_name{5};
constexpr std::chrono::milliseconds listing_retry_pause{50};
constexpr std::chrono::milliseconds denied_pause{2000};

}  // namespace

void Watch::shut() {
  if (on_node) on_node->shut();
  if (on_children) on_children->shut();
}

void Watches::add(const WatchPtr& watch) {
  PlacePtr& place = places_of(*watch)[watch->path];
  if (!place) {
    place = std::make_shared<Place>();
    place->path = watch->path;
    place->lists_children = watch->on_children != nullptr;
  }
  place->watches.push_back(watch);
  if (!connected_ || place->reading) return;  // the answer under way serves this watch too
  if (place->names && !place->scheduled) {    // the list is known: report it without a read
    watch->told = true;
    watch->on_children->deliver_latest(dispatcher_, place->names);
  } else {
    read(place);
  }
}

void Watches::remove(const WatchPtr& watch) {
  Places& places = places_of(*watch);
  const auto found = places.find(watch->path);
  if (found == places.end()) return;
  std::erase(found->second->watches, watch);
  if (found->second->watches.empty()) places.erase(found);
}

void Watches::connected() {
  connected_ = true;
  for (const Places* places : {&nodes_, &lists_}) {
    for (const auto& [path, place] : *places) touch(place);
  }
}

void Watches::changed(const std::string& path) {
  for (const Places* places : {&nodes_, &lists_}) {
    const auto found = places->find(path);
    if (found != places->end()) touch(found->second);
  }
}

void Watches::touch(const PlacePtr& place) {
  if (!connected_ || place->scheduled) return;
  if (place->reading) {
    place->again = true;
    return;
  }
  SerialThread::Instant due = SerialThread::Instant::min();
  if (place->status) {
    const std::size_t names = place->names && *place->names ? (*place->names)->size() : 0;
    due = place->last_read + read_pause + read_pause_per_name * static_cast<int>(names);
  }
  if (due <= std::chrono::steady_clock::now()) {
    read(place);
  } else {
    schedule(place, due);
  }
}

void Watches::schedule(const PlacePtr& place, SerialThread::Instant when) {
  place->scheduled = true;
  worker_.post_at(when, [this, place] {
    place->scheduled = false;
    if (place->watches.empty() || !connected_) return;
    if (place->reading) {
      place->again = true;
    } else {
      read(place);
    }
  });
}

void Watches::read(const PlacePtr& place) {
  place->reading = true;
  place->last_read = std::chrono::steady_clock::now();
  Done done = [this, place](Reply reply) {
    worker_.post([this, place, reply = std::move(reply)]() mutable { answered(place, std::move(reply)); });
  };
  if (place->lists_children) {
    connection_.children(place->path, true, std::move(done));
  } else {
    connection_.get(place->path, true, std::move(done));
  }
}

void Watches::answered(const PlacePtr& place, Reply reply) {
  place->reading = false;
  if (place->watches.empty()) return;
  const bool again = std::exchange(place->again, false);
  if (reply.status != ReplyStatus::ok && reply.status != ReplyStatus::no_node) {
    // If the connection was lost, the next connected() reads again; otherwise the read that is scheduled here does.
    const bool denied = reply.status == ReplyStatus::denied;
    if (denied && !std::exchange(place->complained, true)) {
      logger.warn(
          "{} cannot be watched: it belongs to another user of the registry; are registry.user and "
          "registry.password_file those of the process that created it?",
          place->path);
    }
    if (!place->scheduled) {
      schedule(place, std::chrono::steady_clock::now() + (denied ? denied_pause : listing_retry_pause));
    }
    return;
  }
  report(*place, std::move(reply));
  if (again) touch(place);
}

/// Reports news to all watches, and the current state to those that do not have it yet.
void Watches::report(Place& place, Reply reply) {
  bool fresh = place.status != reply.status;
  if (place.lists_children) {
    std::optional<std::vector<std::string>> names;
    if (reply.status == ReplyStatus::ok) names = std::move(reply.names);
    fresh = fresh || *place.names != names;
    if (fresh) place.names = std::make_shared<const std::optional<std::vector<std::string>>>(std::move(names));
  } else {
    const std::size_t data_hash = std::hash<std::string>()(reply.node.data);
    fresh = fresh || place.version != reply.node.version || place.created != reply.node.created ||
            place.data_hash != data_hash;
    place.data_hash = data_hash;
    place.version = reply.node.version;
    place.created = reply.node.created;
  }
  place.status = reply.status;
  for (const WatchPtr& watch : place.watches) {
    if (!fresh && watch->told) continue;
    watch->told = true;
    if (place.lists_children) {
      watch->on_children->deliver_latest(dispatcher_, place.names);
    } else {
      std::optional<Node> node;
      if (reply.status == ReplyStatus::ok) node = reply.node;
      watch->on_node->deliver_latest(dispatcher_, std::move(node));
    }
  }
}

}  // namespace iotcloud::discovery
