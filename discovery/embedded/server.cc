#include <utility>

#include <fmt/core.h>

#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/embedded/server.h>

namespace iotcloud::discovery::embedded {
namespace {

Reply with_status(ReplyStatus status) {
  Reply reply;
  reply.status = status;
  return reply;
}

}  // namespace

std::shared_ptr<RegistryServer> RegistryServer::named(const std::string& name) {
  static config::Mutex mutex;
  static std::map<std::string, std::weak_ptr<RegistryServer>> servers;
  const config::MutexLock lock(mutex);
  std::weak_ptr<RegistryServer>& known = servers[name];
  auto server = known.lock();
  if (!server) {
    server = std::make_shared<RegistryServer>();
    known = server;
  }
  return server;
}

RegistryServer::RegistryServer() {
  tree_["/"];
}

void RegistryServer::keep_time_by(const config::Clock& clock) {
  const config::MutexLock lock(mutex_);
  clock_ = &clock;
}

std::vector<std::int64_t> RegistryServer::sessions() const {
  const config::MutexLock lock(mutex_);
  std::vector<std::int64_t> numbers;
  for (const auto& [number, session] : sessions_) {
    if (!session.expired) numbers.push_back(number);
  }
  return numbers;
}

void RegistryServer::partition(std::int64_t session) {
  const config::MutexLock lock(mutex_);
  const auto found = sessions_.find(session);
  if (found != sessions_.end()) cut_off(found->second);
}

void RegistryServer::partition_before_next_answer(std::int64_t session) {
  const config::MutexLock lock(mutex_);
  const auto found = sessions_.find(session);
  if (found != sessions_.end()) found->second.loses_answer = true;
}

void RegistryServer::restore(std::int64_t session) {
  const config::MutexLock lock(mutex_);
  if (sessions_.contains(session)) let_in(session);
}

void RegistryServer::stop() {
  const config::MutexLock lock(mutex_);
  down_ = true;
  for (auto& [number, session] : sessions_) cut_off(session);
}

void RegistryServer::start() {
  const config::MutexLock lock(mutex_);
  down_ = false;
  std::vector<std::int64_t> numbers;
  for (const auto& [number, session] : sessions_) numbers.push_back(number);
  for (const std::int64_t number : numbers) let_in(number);
  for (const auto& [number, serves] : std::exchange(questions_, {})) serves();
}

std::int64_t RegistryServer::ask_for_new(std::function<void()> serves) {
  const config::MutexLock lock(mutex_);
  const std::int64_t number = ++last_question_;
  if (down_) {
    questions_.emplace(number, std::move(serves));
  } else {
    serves();
  }
  return number;
}

bool RegistryServer::is_asked() const {
  const config::MutexLock lock(mutex_);
  return !questions_.empty();
}

void RegistryServer::ask_no_more(std::int64_t question) {
  const config::MutexLock lock(mutex_);
  questions_.erase(question);
}

std::shared_ptr<const RegistryServer::Image> RegistryServer::image() const {
  const config::MutexLock lock(mutex_);
  auto image = std::make_shared<Image>(Image{tree_, last_change_});
  std::vector<std::string> ephemeral;
  for (const auto& [path, entry] : tree_) {
    if (entry.node.ephemeral) ephemeral.push_back(path);
  }
  for (const std::string& path : ephemeral) {
    image->tree.at(parent_of(path)).children.erase(name_of(path));
    image->tree.erase(path);
  }
  return image;
}

void RegistryServer::put_back(const std::shared_ptr<const Image>& image) {
  const config::MutexLock lock(mutex_);
  for (auto& [number, session] : sessions_) {
    cut_off(session);
    session.refused = true;
    session.to_tell.clear();
  }
  node_watchers_.clear();
  children_watchers_.clear();
  tree_.clear();
  tree_["/"];
  if (image) tree_ = image->tree;
  last_change_ = image ? image->last_change : 0;
}

void RegistryServer::cut_off(Session& session) {
  if (std::exchange(session.reachable, false)) session.events.disconnected();
}

void RegistryServer::let_in(std::int64_t number) {
  Session& session = sessions_.at(number);
  if (session.reachable || session.refused) return;
  if (session.expired) {
    session.events.expired();
    sessions_.erase(number);
    return;
  }
  session.reachable = true;
  session.events.connected(number, session.timeout);
  for (const std::string& path : std::exchange(session.to_tell, {})) session.events.changed(path);
}

void RegistryServer::expire(std::int64_t session) {
  const config::MutexLock lock(mutex_);
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

std::int64_t RegistryServer::open_session(RegistryConnection::Events events, std::chrono::milliseconds timeout) {
  const config::MutexLock lock(mutex_);
  const std::int64_t number = ++last_session_;
  Session& session = sessions_[number];
  session.events = std::move(events);
  session.timeout = timeout;
  session.reachable = !down_;
  if (session.reachable) session.events.connected(number, timeout);
  return number;
}

void RegistryServer::close_session(std::int64_t session) {
  const config::MutexLock lock(mutex_);
  if (sessions_.erase(session) == 0) return;
  forget_watches(session);
  drop_nodes(session);
}

bool RegistryServer::reachable(std::int64_t session) const {
  const auto found = sessions_.find(session);
  return found != sessions_.end() && found->second.reachable && !found->second.expired;
}

void RegistryServer::create(std::int64_t session, const std::string& path, const std::string& data, bool ephemeral,
                            bool sequential, const Fence& fence, const Done& done) {
  const config::MutexLock lock(mutex_);
  Reply reply;
  if (reachable(session)) {
    reply.status =
        stands(fence) ? put_node(session, path, data, ephemeral, sequential, reply.path) : ReplyStatus::fenced;
    Session& own = sessions_.at(session);
    if (std::exchange(own.loses_answer, false)) {
      reply = with_status(ReplyStatus::away);
      cut_off(own);
    }
  }
  done(std::move(reply));
}

ReplyStatus RegistryServer::put_node(std::int64_t session, const std::string& path, const std::string& data,
                                     bool ephemeral, bool sequential, std::string& real_path) {
  const std::string parent_path = parent_of(path);
  const auto parent = tree_.find(parent_path);
  if (path == "/") return ReplyStatus::exists;
  if (parent == tree_.end()) return ReplyStatus::no_node;
  if (parent->second.node.ephemeral) return ReplyStatus::bad_path;
  real_path = sequential ? fmt::format("{}{:010}", path, parent->second.next_sequence) : path;
  Entry entry;
  entry.node.data = data;
  entry.node.created = last_change_ + 1;
  entry.node.modified_ms = clock_->wall_ms();
  entry.node.ephemeral = ephemeral;
  entry.node.owner_session = ephemeral ? session : 0;
  if (!tree_.emplace(real_path, std::move(entry)).second) return ReplyStatus::exists;
  ++last_change_;
  ++parent->second.next_sequence;
  parent->second.children.insert(name_of(real_path));
  fire(node_watchers_, real_path);
  fire(children_watchers_, real_path);
  fire(children_watchers_, parent_path);
  return ReplyStatus::ok;
}

void RegistryServer::set(std::int64_t session, const std::string& path, const std::string& data,
                         std::int64_t expected_version, const Fence& fence, const Done& done) {
  const config::MutexLock lock(mutex_);
  if (!reachable(session)) {
    done(with_status(ReplyStatus::away));
    return;
  }
  const auto found = tree_.find(path);
  if (!stands(fence)) {
    done(with_status(ReplyStatus::fenced));
  } else if (found == tree_.end()) {
    done(with_status(ReplyStatus::no_node));
  } else if (expected_version >= 0 && found->second.node.version != expected_version) {
    done(with_status(ReplyStatus::bad_version));
  } else {
    found->second.node.data = data;
    ++found->second.node.version;
    found->second.node.modified_ms = clock_->wall_ms();
    ++last_change_;
    fire(node_watchers_, path);
    done(with_status(ReplyStatus::ok));
  }
}

void RegistryServer::remove(std::int64_t session, const std::string& path, std::int64_t expected_version,
                            const Fence& fence, const Done& done) {
  const config::MutexLock lock(mutex_);
  if (!reachable(session)) {
    done(with_status(ReplyStatus::away));
    return;
  }
  const auto found = tree_.find(path);
  if (!stands(fence)) {
    done(with_status(ReplyStatus::fenced));
  } else if (path == "/") {
    done(with_status(ReplyStatus::bad_path));
  } else if (found == tree_.end()) {
    done(with_status(ReplyStatus::no_node));
  } else if (expected_version >= 0 && found->second.node.version != expected_version) {
    done(with_status(ReplyStatus::bad_version));
  } else if (!found->second.children.empty()) {
    done(with_status(ReplyStatus::not_empty));
  } else {
    erase(path);
    done(with_status(ReplyStatus::ok));
  }
}

template <typename Fill>
void RegistryServer::read(std::int64_t session, const std::string& path, Watchers* watchers, const Done& done,
                          Fill&& fill) {
  const config::MutexLock lock(mutex_);
  if (!reachable(session)) {
    done(with_status(ReplyStatus::away));
    return;
  }
  if (watchers) (*watchers)[path].insert(session);
  const auto found = tree_.find(path);
  Reply reply = with_status(found == tree_.end() ? ReplyStatus::no_node : ReplyStatus::ok);
  if (found != tree_.end()) fill(reply, found->second);
  done(std::move(reply));
}

void RegistryServer::get(std::int64_t session, const std::string& path, bool watch, const Done& done) {
  read(session, path, watch ? &node_watchers_ : nullptr, done,
       [](Reply& reply, const Entry& entry) { reply.node = entry.node; });
}

void RegistryServer::children(std::int64_t session, const std::string& path, bool watch, const Done& done) {
  read(session, path, watch ? &children_watchers_ : nullptr, done,
       [](Reply& reply, const Entry& entry) { reply.names.assign(entry.children.begin(), entry.children.end()); });
}

void RegistryServer::erase(const std::string& path) {
  const std::string parent_path = parent_of(path);
  tree_.erase(path);
  tree_.at(parent_path).children.erase(name_of(path));
  ++last_change_;
  fire(node_watchers_, path);
  fire(children_watchers_, path);
  fire(children_watchers_, parent_path);
}

void RegistryServer::drop_nodes(std::int64_t session) {
  std::vector<std::string> owned;
  for (const auto& [path, entry] : tree_) {
    if (entry.node.ephemeral && entry.node.owner_session == session) owned.push_back(path);
  }
  for (const std::string& path : owned) erase(path);
}

void RegistryServer::forget_watches(std::int64_t session) {
  for (Watchers* watchers : {&node_watchers_, &children_watchers_}) {
    for (auto place = watchers->begin(); place != watchers->end();) {
      place->second.erase(session);
      place = place->second.empty() ? watchers->erase(place) : std::next(place);
    }
  }
}

void RegistryServer::fire(Watchers& watchers, const std::string& path) {
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
