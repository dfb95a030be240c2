package iotcloud.storm;

import java.util.concurrent.Executors;
import java.util.concurrent.ScheduledExecutorService;
import java.util.concurrent.ScheduledFuture;
import java.util.concurrent.TimeUnit;

/** One thread of this process for all that comes in periods. */
final class Timers {
  private static final ScheduledExecutorService THREAD = Executors.newSingleThreadScheduledExecutor(work -> {
    Thread thread = new Thread(work, "iotcloud-timers");
    thread.setDaemon(true);
    return thread;
  });

  private Timers() {}

  static ScheduledFuture<?> every(long micros, Runnable call) {
    return THREAD.scheduleAtFixedRate(call, micros, micros, TimeUnit.MICROSECONDS);
  }
}
