package iotcloud.storm;

import java.util.Map;
import java.util.concurrent.ConcurrentHashMap;

/** The thread that applies the answers which threads of C++ give between two calls of a bolt. */
final class Egress {
  private static final Map<Long, Runnable> BOLTS = new ConcurrentHashMap<>();

  private Egress() {}

  static void start() {
    Thread thread = new Thread(Egress::run, "iotcloud-egress");
    thread.setDaemon(true);
    thread.start();
  }

  /** Lets `apply` fetch a bolt's answers. */
  static void add(long answering, Runnable apply) {
    BOLTS.put(answering, apply);
  }

  private static void run() {
    while (true) {
      BOLTS.get(Native.awaitAnswers()).run();
    }
  }
}
