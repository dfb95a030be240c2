// A driver whose books say what its channel accepted. Each life of an instance is a run with a name of its own, and
// numbers its messages 1, 2, ... FOLDER/INSTANCE.sent has a line for
//   run RUN TIME        the instance was opened
//   sent RUN NUMBER TIME   publish() returned `accepted` for this message
//   end RUN TIME        the instance was closed; a run without this line was killed
// where RUN is "PROCESS.MICROSECONDS", so that no two are alike. FOLDER/INSTANCE.heard has a line for each command that
// came back on the channel `command`, which all instances of the gateway share: "RUN NUMBER RECEIVER TIME", where RUN
// and NUMBER are those of the message that the command answers, and RECEIVER is the run that got it. Properties:
// `folder`; `rate`, messages a second; `kind`: `spooled` or `blocked`, which is the channel's name, too; `shared`: one
// topic for all instances on the gateway. It sends while the file FOLDER/go exists.
#include <algorithm>
#include <chrono>
#include <filesystem>
#include <string>

#include "book.h"

#include <iotcloud/drivers/plugin.h>
#include <iotcloud/drivers/property_reader.h>

namespace {

namespace drivers = iotcloud::drivers;

class Ledger final : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap& properties) override {
    drivers::PropertyReader reader(properties);
    folder_ = reader.text("folder", "");
    rate_ = reader.integer("rate", 25, 1, 1000);
    kind_ = reader.text("kind", "spooled");
    const bool shared = reader.flag("shared", false);
    reader.finish();
    drivers::ChannelSpec data;
    data.name = kind_;
    data.durable = true;
    data.shared = shared;
    data.when_full = kind_ == "spooled" ? drivers::WhenFull::spool : drivers::WhenFull::block;
    drivers::ChannelSpec command;
    command.name = "command";
    command.direction = drivers::Direction::in;
    command.durable = true;
    command.shared = true;
    return {data, command};
  }

  void open(drivers::DriverContext& context) override {
    context_ = &context;
    run_ = std::to_string(::getpid()) + '.' +
           std::to_string(std::chrono::steady_clock::now().time_since_epoch() / std::chrono::microseconds(1));
    book_ = Book(folder_ / (context.instance_id() + ".sent"));
    book_.write("run " + run_);
    heard_ = Book(folder_ / (context.instance_id() + ".heard"));
  }
  void activate() override {
    timer_ = context_->every(std::chrono::microseconds(1'000'000 / rate_), [this] { send(); });
  }
  void deactivate() override { context_->stop(timer_); }
  void close() override { book_.write("end " + run_); }
  // NOLINTNEXTLINE(performance-unnecessary-value-param): the SDK's signature
  void on_message(std::string_view /*channel*/, drivers::Message message) override {
    heard_.write(Entry::parse(message.payload.text()).run_and_number + ' ' + run_);
  }

 private:
  void send() {
    std::error_code none;
    if (!std::filesystem::exists(folder_ / "go", none)) return;
    const std::string entry = run_ + ' ' + std::to_string(next_);
    if (context_->publish(kind_, drivers::Payload::copy(context_->instance_id() + ' ' + entry)) !=
        drivers::PublishStatus::accepted) {
      return;
    }
    book_.write("sent " + entry);
    ++next_;
  }

  drivers::DriverContext* context_ = nullptr;
  drivers::HandlerId timer_{};
  std::filesystem::path folder_;
  std::string kind_, run_;
  std::int64_t rate_ = 1;
  std::uint64_t next_ = 1;
  Book book_, heard_;
};

}  // namespace

IOTCLOUD_DRIVER(Ledger, "ledger", "1.0")
