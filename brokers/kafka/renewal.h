#pragma once

#include <array>
#include <chrono>
#include <functional>
#include <memory>
#include <set>
#include <string>

#include "iotcloud/brokers/kafka/client.h"
#include <iotcloud/config/clock.h>
#include <iotcloud/config/file_stamp.h>

namespace iotcloud::brokers::kafka {

/// Follows the files of certificates, key, authorities and revocations that a client was made with. The library reads
/// them only when it makes a client, so once they have changed another client must take over: this class makes it, and
/// offers it when a server has let it in. Until then, and if the new files are of no use, the present client goes on;
/// but with another list of revocations, or without an authority that it had, it is offered at once, because the
/// present one may have a server that is not trusted any more. Not thread safe.
class Renewal {
 public:
  using Instant = config::Clock::Instant;
  using Make = std::function<std::shared_ptr<KafkaClient>()>;

  /// \param options outlive this object. \param make makes a client that delivers RD_KAFKA_EVENT_ERROR
  Renewal(const KafkaOptions& options, Make make);

  /// The client to use from now on: the one that is ready, otherwise a new one.
  /// \throws ClientError; config::Error if the password cannot be read.
  std::shared_ptr<KafkaClient> client();
  /// Whether client() should take over from the present client. May read files and make a client.
  bool ready(Instant now);
  /// Whether a client was made that no server has let in yet: ready() is to be called often.
  bool pending() const { return next_ != nullptr; }

 private:
  /// How often the files are looked at. They are taken when two looks find the same, because several are written one
  /// after the other.
  static constexpr std::chrono::milliseconds look_period{1000};

  using Mark = std::array<config::FileStamp, 4>;  ///< the list of revocations is the last
  struct Files {
    Mark mark{};
    std::set<std::string> authorities{};  ///< their certificates, as the file has them
  };
  Mark mark() const;
  Files files(const Mark& mark) const;
  void look();
  void make_next(const Mark& mark);
  void serve_events();
  void complain(const std::string& why);
  bool next_may_take_over() const;

  const KafkaOptions& options_;
  const Make make_;
  Files used_;   ///< of the present client
  Mark seen_{};  ///< at the last look
  Files of_next_;
  Instant look_at_{};
  std::shared_ptr<KafkaClient> next_;
  std::set<std::string> complaints_;  ///< those that the log has, since the files changed
};

}  // namespace iotcloud::brokers::kafka
