#include <utility>

#include <fmt/core.h>

#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/embedded/server.h>

namespace iotcloud::discovery::embedded {
namespace {

Reply with_status(Status status) {
  Reply reply;
  reply.status = status;
  return reply;
}

}  // namespace

std::shared_ptr<Server> Server::named(const std::string& name) {
  static std::mutex mutex;
  static std::map<std::string, std::weak_ptr<Server>> servers;
  const std::lock_guard lock(mutex);
  std::weak_ptr<Server>& known = servers[name];
  auto server = known.lock();
  if (!server) {
    server = std::make_shared<Server>();
    known = server;
  }
  return server;
}

Server::Server() {
  tree_["/"];
}

std::vector<std::int64_t> Server::sessions() const {
  const std::lock_guard lock(mutex_);
  std::vector<std::int64_t> numbers;
  for (const auto& [number, session] : sessions_) {
    if (!session.expired) numbers.push_back(number);
  }
  return numbers;
}

void Server::partition(std::int64_t session) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(session);
  if (found != sessions_.end()) cut_off(found->second);
}

void Server::partition_before_next_answer(std::int64_t session) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(session);
  if (found != sessions_.end()) found->second.loses_answer = true;
}

void Server::restore(std::int64_t session) {
  const std::lock_guard lock(mutex_);
  if (sessions_.contains(session)) let_in(session);
}

void Server::stop() {
  const std::lock_guard lock(mutex_);
  down_ = true;
  for (auto& [number, session] : sessions_) cut_off(session);
}

void Server::start() {
  const std::lock_guard lock(mutex_);
  down_ = false;
  std::vector<std::int64_t> numbers;
  for (const auto& [number, session] : sessions_) numbers.push_back(number);
  for (const std::int64_t number : numbers) let_in(number);
}

void Server::cut_off(Session& session) {
  if (std::exchange(session.reachable, false)) session.events.disconnected();
}

void Server::let_in(std::int64_t number) {
  Session& session = sessions_.at(number);
  if (session.reachable) return;
  if (session.expired) {
    session.events.expired();
    sessions_.erase(number);
    return;
  }
  session.reachable = true;
  session.events.connected(number, session.timeout);
  for (const std::string& path : std::exchange(session.to_tell, {})) session.events.changed(path);
}

void Server::expire(std::int64_t session) {
  const std::lock_guard lock(mutex_);
  const auto found = sessions_.find(session);
  if (found == sessions_.end() || found->second.expired) return;
  found->second.expired = true;
  forget_watches(session);
  drop_nodes(session);
  if (found->second.reachable) {
    found->second.events.expired();
    sessions_.erase(found);
  }
}

std::int64_t Server::open_session(Connection::Events events, std::chrono::milliseconds timeout) {
  const std::lock_guard lock(mutex_);
  const std::int64_t number = ++last_session_;
  Session& session = sessions_[number];
  session.events = std::move(events);
  session.timeout = timeout;
  session.reachable = !down_;
  if (session.reachable) session.events.connected(number, timeout);
  return number;
}

void Server::close_session(std::int64_t session) {
  const std::lock_guard lock(mutex_);
  if (sessions_.erase(session) == 0) return;
  forget_watches(session);
  drop_nodes(session);
}

bool Server::reachable(std::int64_t session) const {
  const auto found = sessions_.find(session);
  return found != sessions_.end() && found->second.reachable && !found->second.expired;
}

void Server::create(std::int64_t session, const std::string& path, const std::string& data, bool ephemeral,
                    bool sequential, const Fence& fence, const Done& done) {
  const std::lock_guard lock(mutex_);
  Reply reply;
  if (reachable(session)) {
    reply.status = stands(fence) ? put_node(session, path, data, ephemeral, sequential, reply.path) : Status::fenced;
    Session& own = sessions_.at(session);
    if (std::exchange(own.loses_answer, false)) {
      reply = with_status(Status::away);
      cut_off(own);
    }
  }
  done(std::move(reply));
}

Status Server::put_node(std::int64_t session, const std::string& path, const std::string& data, bool ephemeral,
                        bool sequential, std::string& real_path) {
  const std::string parent_path = parent_of(path);
  const auto parent = tree_.find(parent_path);
  if (path == "/") return Status::exists;
  if (parent == tree_.end()) return Status::no_node;
  if (parent->second.node.ephemeral) return Status::bad_path;
  real_path = sequential ? fmt::format("{}{:010}", path, parent->second.next_sequence) : path;
  Entry entry;
  entry.node.data = data;
  entry.node.created = last_change_ + 1;
  entry.node.ephemeral = ephemeral;
  entry.node.owner_session = ephemeral ? session : 0;
  if (!tree_.emplace(real_path, std::move(entry)).second) return Status::exists;
  ++last_change_;
  ++parent->second.next_sequence;
  parent->second.children.insert(name_of(real_path));
  fire(node_watchers_, real_path);
  fire(children_watchers_, real_path);
  fire(children_watchers_, parent_path);
  return Status::ok;
}

void Server::set(std::int64_t session, const std::string& path, const std::string& data, std::int64_t expected_version,
                 const Fence& fence, const Done& done) {
  const std::lock_guard lock(mutex_);
  if (!reachable(session)) {
    done(with_status(Status::away));
    return;
  }
  const auto found = tree_.find(path);
  if (!stands(fence)) {
    done(with_status(Status::fenced));
  } else if (found == tree_.end()) {
    done(with_status(Status::no_node));
  } else if (expected_version >= 0 && found->second.node.version != expected_version) {
    done(with_status(Status::bad_version));
  } else {
    found->second.node.data = data;
    ++found->second.node.version;
    ++last_change_;
    fire(node_watchers_, path);
    done(with_status(Status::ok));
  }
}

void Server::remove(std::int64_t session, const std::string& path, std::int64_t expected_version, const Fence& fence,
                    const Done& done) {
  const std::lock_guard lock(mutex_);
  if (!reachable(session)) {
    done(with_status(Status::away));
    return;
  }
  const auto found = tree_.find(path);
  if (!stands(fence)) {
    done(with_status(Status::fenced));
  } else if (path == "/") {
    done(with_status(Status::bad_path));
  } else if (found == tree_.end()) {
    done(with_status(Status::no_node));
  } else if (expected_version >= 0 && found->second.node.version != expected_version) {
    done(with_status(Status::bad_version));
  } else if (!found->second.children.empty()) {
    done(with_status(Status::not_empty));
  } else {
    erase(path);
    done(with_status(Status::ok));
  }
}

void Server::get(std::int64_t session, const std::string& path, bool watch, const Done& done) {
  const std::lock_guard lock(mutex_);
  if (!reachable(session)) {
    done(with_status(Status::away));
    return;
  }
  if (watch) node_watchers_[path].insert(session);
  const auto found = tree_.find(path);
  Reply reply = with_status(found == tree_.end() ? Status::no_node : Status::ok);
  if (found != tree_.end()) reply.node = found->second.node;
  done(std::move(reply));
}

void Server::children(std::int64_t session, const std::string& path, bool watch, const Done& done) {
  const std::lock_guard lock(mutex_);
  if (!reachable(session)) {
    done(with_status(Status::away));
    return;
  }
  if (watch) children_watchers_[path].insert(session);
  const auto found = tree_.find(path);
  Reply reply = with_status(found == tree_.end() ? Status::no_node : Status::ok);
  if (found != tree_.end()) reply.names.assign(found->second.children.begin(), found->second.children.end());
  done(std::move(reply));
}

void Server::erase(const std::string& path) {
  const std::string parent_path = parent_of(path);
  tree_.erase(path);
  tree_.at(parent_path).children.erase(name_of(path));
  ++last_change_;
  fire(node_watchers_, path);
  fire(children_watchers_, path);
  fire(children_watchers_, parent_path);
}

void Server::drop_nodes(std::int64_t session) {
  std::vector<std::string> owned;
  for (const auto& [path, entry] : tree_) {
    if (entry.node.ephemeral && entry.node.owner_session == session) owned.push_back(path);
  }
  for (const std::string& path : owned) erase(path);
}

void Server::forget_watches(std::int64_t session) {
  for (Watchers* watchers : {&node_watchers_, &children_watchers_}) {
    for (auto place = watchers->begin(); place != watchers->end();) {
      place->second.erase(session);
      place = place->second.empty() ? watchers->erase(place) : std::next(place);
    }
  }
}

void Server::fire(Watchers& watchers, const std::string& path) {
  const auto found = watchers.find(path);
  if (found == watchers.end()) return;
  const std::set<std::int64_t> to_tell = std::move(found->second);
  watchers.erase(found);
  for (const std::int64_t number : to_tell) {
    Session& session = sessions_.at(number);
    if (session.reachable) {
      session.events.changed(path);
    } else {
      session.to_tell.push_back(path);
    }
  }
}

}  // namespace iotcloud::discovery::embedded
