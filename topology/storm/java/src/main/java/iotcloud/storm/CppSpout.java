package iotcloud.storm;

import java.util.ArrayDeque;
import java.util.Collections;
import java.util.List;
import java.util.Map;
import java.util.Queue;
import java.util.concurrent.locks.Lock;
import java.util.concurrent.locks.ReentrantLock;
import java.util.function.IntSupplier;
import org.apache.storm.spout.SpoutOutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.IRichSpout;

/**
 * A spout of C++. Only Storm's executor calls it, so nothing emits from another thread. Without ackers Storm calls ack()
 * inside of an emit, and a message fails there for which a grouping chooses no task; C++ hears of it after the call that
 * emitted.
 */
public class CppSpout extends CppComponent implements IRichSpout {
  private static final long serialVersionUID = 1;
  private transient NativeTask task;
  private transient boolean busy;
  private transient Queue<IntSupplier> late;

  /** The component of the topology's file whose id is this component's. */
  public CppSpout(String file) {
    super(file);
  }

  /** A class of a component library, for Flux and Java. */
  public CppSpout(String library, String className) {
    this(library, className, Collections.emptyMap());
  }

  /** The same; `conf` has texts, numbers and booleans. */
  public CppSpout(String library, String className, Map<String, ?> conf) {
    super("spout", library, className, conf);
  }

  @Override
  public void open(Map<String, Object> conf, TopologyContext context, SpoutOutputCollector collector) {
    try {
      late = new ArrayDeque<>();
      Native.load(Description.folder(context));
      List<Output> outputs = Description.outputs(context);
      task = new NativeTask(Description.of(origin, context, outputs), outputs, new Emitter(collector));
      if (!Native.isSpout(task.handle)) {
        throw new IllegalArgumentException(context.getThisComponentId() + " is a bolt in C++, not a spout");
      }
      run(() -> Native.open(task.handle));
    } catch (RuntimeException | UnsatisfiedLinkError error) {
      collector.reportError(error);
      throw error;
    }
  }

  @Override
  public void nextTuple() {
    busy = true;
    try {
      task.applyHere(Native.nextTuple(task.handle));
    } finally {
      busy = false;
    }
    runLate();
  }

  @Override
  public void ack(Object id) {
    Sent sent = (Sent) id;
    long took = sent.times == 0 ? 0 : System.nanoTime() - sent.at;
    if (busy) {
      late.add(() -> Native.ack(task.handle, sent.id, took, sent.times));
      return;
    }
    busy = true;
    try {
      task.applyHere(Native.ack(task.handle, sent.id, took, sent.times));
    } finally {
      busy = false;
    }
    runLate();
  }

  @Override
  public void fail(Object id) {
    IntSupplier call = () -> Native.fail(task.handle, ((Sent) id).id);
    if (busy) {
      late.add(call);
    } else {
      run(call);
    }
  }

  @Override
  public void activate() {
    run(() -> Native.activate(task.handle, true));
  }

  @Override
  public void deactivate() {
    run(() -> Native.activate(task.handle, false));
  }

  @Override
  public void close() {
    run(() -> Native.close(task.handle));
  }

  private void run(IntSupplier call) {
    runAlone(call);
    runLate();
  }

  private void runAlone(IntSupplier call) {
    busy = true;
    try {
      task.applyHere(call.getAsInt());
    } finally {
      busy = false;
    }
  }

  /** What these calls leave waits for Storm's next call: a spout that emits again what cannot be sent would not end. */
  private void runLate() {
    for (int left = late.size(); left > 0; left--) {
      runAlone(late.remove());
    }
  }

  /**
   * The component's id of a message, as Storm keeps it. `at`: when it was emitted, if it stands for `times` messages
   * (more than 0) of which it is the measured one.
   */
  private static final class Sent {
    final long id;
    final long at;
    final long times;

    Sent(long id, long at, long times) {
      this.id = id;
      this.at = at;
      this.times = times;
    }
  }

  /** Chooses the messages that are measured, as shim/call_timer.h chooses the calls. */
  private static final class Sample {
    private static final long MOST = 16;
    private static final long CLOSELY_NS = 20_000;
    private long last;
    private long sent;
    private long every = 1;

    Sent next(long id) {
      if (++sent < every) {
        return new Sent(id, 0, 0);
      }
      long now = System.nanoTime();
      long times = sent;
      every = now - last < times * CLOSELY_NS ? MOST : 1;
      last = now;
      sent = 0;
      return new Sent(id, now, times);
    }
  }

  /** Applies the component's commands. */
  private final class Emitter implements NativeTask.Collector {
    private final SpoutOutputCollector collector;
    private final Lock lock = new ReentrantLock();
    private final Sample sample = new Sample();

    Emitter(SpoutOutputCollector collector) {
      this.collector = collector;
    }

    @Override
    public Lock lock() {
      return lock;
    }

    @Override
    public void executes(int slot) {
      throw new IllegalStateException("a spout executes a tuple");
    }

    @Override
    public List<Integer> emit(String stream, int to, Long id, List<Object> values) {
      Sent sent = id == null ? null : sample.next(id);
      try {
        if (to < 0) {
          return collector.emit(stream, values, sent);
        }
        collector.emitDirect(to, stream, values, sent);
        return Collections.singletonList(to);
      } catch (GroupingError error) {
        collector.reportError(new ComponentError(error.getMessage()));
        if (sent != null) {
          fail(sent);
        }
        return Collections.emptyList();
      }
    }

    @Override
    public List<Integer> emit(String stream, int to, int[] anchors, int count, List<Object> values) {
      throw new IllegalStateException("a spout emits as a bolt");
    }

    @Override
    public Object value(int slot, int place) {
      throw new IllegalStateException("a spout emits a bolt's values");
    }

    @Override
    public void answer(byte command, int slot) {
      throw new IllegalStateException("a spout answers as a bolt");
    }

    @Override
    public void reportError(Throwable error) {
      collector.reportError(error);
    }
  }
}
