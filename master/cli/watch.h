#pragma once

#include <functional>
#include <string>
#include <vector>

#include <iotcloud/master/cli/verb.h>

namespace iotcloud::master::cli {

/// The option --watch, for verbs whose answer may be shown again and again until interrupted.
class WatchOption {
 public:
  void declare(CLI::App& options);
  bool on() const { return seconds_ > 0; }
  /// The words of a command line, with this option if it is on.
  std::vector<std::string> add_to(std::vector<std::string> words) const;
  /// Shows an answer once, or again every so many seconds. On a terminal each answer takes the place of the one before.
  /// \param once shows it. \return the last exit status
  int run(Call& call, const std::function<int()>& once) const;

 private:
  double seconds_ = 0;  ///< 0: once
};

/// A verb that shows what there is now.
class WatchedVerb : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override { watch_.declare(options); }
  bool goes_on() const override { return watch_.on(); }
  int run(Call& call) override {
    const auto master = call.connect();
    return watch_.run(call, [&] { return show(call, *master); });
  }

 protected:
  virtual int show(Call& call, MasterClient& master) = 0;
  const WatchOption& watched() const { return watch_; }

 private:
  WatchOption watch_;
};

}  // namespace iotcloud::master::cli
