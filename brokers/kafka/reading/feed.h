#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "iotcloud/brokers/kafka/client.h"
#include "iotcloud/brokers/kafka/reading/progress.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers::kafka {

class Reader;
struct Member;

/// One subscription. Guarded by the reader's mutex, constants apart.
struct Inlet {
  Inlet(std::shared_ptr<Member> of, Topic to, SubscriptionOptions how, Handler what)
      : member(std::move(of)), topic(std::move(to)), options(std::move(how)), handler(std::move(what)) {}
  const std::shared_ptr<Member> member;
  const Topic topic;
  const SubscriptionOptions options;
  const Handler handler;
  std::size_t unsettled = 0;  ///< deliveries of its feeds, waiting ones included
  bool paused = false;
  bool closed = false;
  bool running = false;  ///< its handler runs
};

/// A topic and one of its partitions.
using PartitionKey = std::pair<std::string, std::int32_t>;

/// One partition that the group gave to this process. Guarded by the reader's mutex, constants apart.
class Feed final : public Settler, public std::enable_shared_from_this<Feed> {
 public:
  Feed(std::shared_ptr<Reader> to, std::shared_ptr<Member> of, std::shared_ptr<Client> from, PartitionKey what,
       Progress how_far);
  ~Feed() override = default;
  void settle(std::uint64_t tag, Settlement settlement) noexcept override;

  const std::shared_ptr<Reader> reader;
  const std::shared_ptr<Member> member;
  const PartitionKey key;

  std::shared_ptr<Client> client;  ///< null once it is closed
  Queue queue;                     ///< where its records come in; signals the reader when it is not empty any more
  Progress progress;
  std::shared_ptr<Inlet> inlet;  ///< who reads it now; may be null
  std::uint64_t generation = 0;  ///< counts readers, so that late settlements of an earlier one are known as such
  bool may_have_more = false;    ///< the queue was not seen empty since the last signal
  bool leaving = false;          ///< the group wants it back: nothing more is handed on
  bool closed = false;
  bool running = false;  ///< a handler runs with a message of it
  bool in_ready = false;
  bool dirty = true;        ///< there may be something to commit
  bool complained = false;  ///< the last record could not be understood, and that was logged

  /// What the user's Delivery carries: the tag, made unique over all readers of this feed.
  std::uint64_t public_tag(std::uint64_t tag) const { return generation << 48U | tag; }
};

/// This process as a member of one group. Guarded by the reader's mutex, constants apart.
struct Member {
  explicit Member(std::string group) : name(std::move(group)) {}
  const std::string name;
  bool connected = false;
  std::vector<std::shared_ptr<Inlet>> inlets;  ///< the first of a topic reads it, others stand by
  std::map<PartitionKey, std::shared_ptr<Feed>> feeds;
};

}  // namespace iotcloud::brokers::kafka
